"""What neural surface materials are trained on: small geometry, bent onto cylinders, and light traced through it."""
