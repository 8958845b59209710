"""Grass at 16², which says nothing about quality: it trains in minutes, so that tests can run all that a training run does."""

from mesoshell.train.presets import TINY

config = TINY
