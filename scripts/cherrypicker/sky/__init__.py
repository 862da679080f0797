"""Sky: network, training, masks of photos and dominant sky colours (paper, section Denoising)."""
