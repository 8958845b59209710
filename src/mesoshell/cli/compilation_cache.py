"""Compiled programs kept between commands: a second render, or a run that goes on, starts at once."""

import warnings

import jax

from mesoshell.io.cache import cache_folder, forget

#: When a command begins, before its own are added.
MAX_BYTES = 1 << 30


def keep_compiled() -> list[float]:
    """Keep compiled programs between runs; returns a list that collects the seconds spent compiling."""
    room = cache_folder("xla")
    forget(room, MAX_BYTES)  # JAX marks no use: what was compiled first
    jax.config.update("jax_compilation_cache_dir", str(room))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    # JAX writes entries in place: one that another command is writing, or left half-written when it was killed, cannot be read,
    # and its program is compiled again
    warnings.filterwarnings("ignore", "Error reading persistent compilation cache entry", UserWarning)
    seconds: list[float] = []

    def note(event: str, duration_secs: float, **_: str | int) -> None:
        if event.endswith("backend_compile_duration"):
            seconds.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(note)
    return seconds
