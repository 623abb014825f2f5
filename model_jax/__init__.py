"""model_jax"""
