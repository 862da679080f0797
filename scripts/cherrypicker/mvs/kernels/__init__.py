"""The compiled inner loops of PatchMatch."""
