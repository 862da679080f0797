"""What the photos say of a finished skeleton."""
