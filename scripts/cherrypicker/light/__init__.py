"""Light that a tree receives, by rays on its tubes: from the sky, and from a season's sun."""
