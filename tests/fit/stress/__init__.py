"""Tests of the fits that are hard on purpose."""
