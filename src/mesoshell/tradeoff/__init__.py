"""What accuracy costs in time: a scene's settings are varied, measured against a reference, and shown."""
