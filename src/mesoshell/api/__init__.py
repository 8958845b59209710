"""The library's own functions, as `import mesoshell as ms` gives them; docs/api.md shows them at work."""
