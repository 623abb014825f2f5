"""Error against run time: renders, the combine step, fits and their peers."""
