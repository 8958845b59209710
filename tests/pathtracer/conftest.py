"""Mitsuba is made ready before any file here imports it."""

from mesoshell.pathtracer.variant import set_variant

set_variant()
