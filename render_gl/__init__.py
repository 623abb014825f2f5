"""render_gl"""
