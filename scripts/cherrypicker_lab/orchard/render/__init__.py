"""Photos of a scene with Blender, and their exact maps."""
