"""A finished tree in the formats of other tools: one module a format, `table` lists them."""
