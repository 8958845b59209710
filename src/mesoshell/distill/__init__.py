"""Distil surface materials from neural shells or geometry: the sources, and the error."""
