"""Materials that mesoshell finds by name; no code."""
