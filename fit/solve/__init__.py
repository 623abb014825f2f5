"""The solver: from samples to a checked end point. Knows no file format and no page."""
