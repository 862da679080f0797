"""The command `cherrypicker`: one module a subcommand, each with its `parser` and its `main`."""
