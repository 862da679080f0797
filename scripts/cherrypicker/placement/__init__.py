"""Where the tree is, and where its own frame lies: region of interest, later align and crop."""
