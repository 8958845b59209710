"""The library's own functions, as `import mesoshell as ms` gives them; docs/tutorials/library.md shows them at work."""
