"""Benchmark of skeletons: how contracted points and graphs compare with a true skeleton."""
