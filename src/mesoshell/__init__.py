"""mesoshell: grass, carpet and fur for any mesh, as neural reflectance shells.

Importing this package loads no JAX; the modules that compute do.
"""

__version__ = "0.1.0"
