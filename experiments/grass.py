"""Grass from 64² renders: small enough for a CPU, and what other experiments are compared with."""

from mesoshell.train.presets import SMALL

config = SMALL
