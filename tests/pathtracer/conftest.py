"""The path tracer makes Mitsuba ready before any file here imports it."""

import mesoshell.pathtracer  # noqa: F401
