"""What stands in a scene, what it looks like, and where the cameras stand."""
