"""Pages and figures of a tree and of the batch; modules are imported one by one, lightly."""
