"""Hand measurements beside ours: their table, their places on the tree, how well both agree."""
