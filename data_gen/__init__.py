"""Blender recipes that render training data. They talk to the rest of the project through files alone."""
