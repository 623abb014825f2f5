"""How fast a fit is, beside its peers."""
