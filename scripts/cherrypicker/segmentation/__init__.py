"""Labels of metric clouds: tree organs and what stands around (paper, Point Cloud Segmentor)."""
