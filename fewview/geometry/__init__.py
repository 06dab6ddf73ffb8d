"""Rigid motions, cameras and point sets: the ground floor, free of any I/O."""
