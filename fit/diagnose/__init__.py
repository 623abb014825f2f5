"""What an end point is worth: errors, influence, misfits, and whether there is air."""
