"""What is hard about a scene, checked on the scene itself (it is also the library's function)."""
