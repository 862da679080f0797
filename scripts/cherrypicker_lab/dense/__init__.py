"""How good dense stereo is: scores of clouds against rendered scenes, true cameras and depths."""
