"""A batch of trees: table and config, costs, locks, and the code that rules watch."""
