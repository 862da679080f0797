"""Training of the point cloud network on generated scenes, and its held-out measure."""
