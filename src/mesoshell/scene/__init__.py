"""A scene as its user describes it, made ready for an engine: set-up, defaults, level of detail, and a file for each engine."""
