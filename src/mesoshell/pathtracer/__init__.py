"""Shells in scenes of Mitsuba 3: `load_file` and `load_dict` give an ordinary `mi.Scene`. Importing it sets the variant."""

from mesoshell.pathtracer.variant import set_variant

set_variant()

from mesoshell.pathtracer.load import load_dict, load_file  # noqa: E402  (after the variant)

__all__ = ["load_dict", "load_file"]
