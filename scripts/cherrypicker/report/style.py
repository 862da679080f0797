"""How the figures look: colours, fonts, lines and sizes, all of them taste."""

from cherrypicker.classes import Label

DPI = 100

#: Of the classes, one for each `Label`.
CLASS_COLORS: dict[int, tuple[float, float, float]] = {
    Label.GROUND: (0.62, 0.55, 0.42),
    Label.TRUNK: (0.45, 0.24, 0.10),
    Label.BRANCH: (0.18, 0.55, 0.24),
    Label.SIGN: (0.95, 0.77, 0.06),
    Label.MARKER: (0.84, 0.15, 0.16),
    Label.CALIBRATION_UNIT: (0.12, 0.47, 0.71),
    Label.ROOF: (0.55, 0.34, 0.76),
    Label.SUPPORT_POST: (0.50, 0.50, 0.50),
    Label.UNLABELLED: (0.80, 0.80, 0.80),
}

COLOR = {
    "fit": "#b3261e",  # what was fitted to points: skeleton, circles
    "camera": "#d02020",  # photos, and what was removed
    "level": "#2368a8",  # ground, borders of the region
    "corner": "#ff3030",  # of markers
    "root": "k",
    "junction": "#202020",
    "tip": "#f2a33a",
    "branch": "#1c6b34",  # contracted points
    "trunk": "#8a2f10",
}
#: Branch orders; they repeat.
ORDER_COLORS = ("#5b3a1e", "#c2571a", "#2b7a3d", "#2368a8", "#8a3fa0", "#c43b6b", "#4f9da6")
#: Wood below a skeleton; how far a cloud is paled below red points.
GREY = {"wood": 0.78, "paled": 0.35}
#: Sky over a photo: its RGB and how much of it.
SKY_TINT, SKY_SHARE = (0.1, 0.35, 0.95), 0.6
#: A cloud without colours: RGB of its lowest and highest points.
LOW_COLOR, HIGH_COLOR = (0.15, 0.25, 0.35), (0.85, 0.70, 0.35)

FONT = {"title": 12, "panel": 10, "tile": 9, "note": 8, "fine": 7}

LINE = {
    "thin": 1.0,
    "border": 1.2,
    "circle": 1.4,
    "order": 1.6,
    "least_wood": 0.6,  # a skeleton's thinnest line, and what its thickest has more
    "most_wood": 2.4,
}
#: Areas of marks, pt².
MARK = {
    "root": 40,
    "junction": 9,
    "tip": 6,
    "camera": 14,
    "camera_aligned": 5,
    "stem": 60,
}
#: Part of a view's box that is left free around it.
MARGIN = 0.05
#: Inches but for what is named px; shares of a figure's width or of a view's.
LAYOUT = {
    "pad": 0.1,  # around a figure
    "axis": 0.7,  # for the numbers beside a panel
    "heading": 0.75,  # for title and numbers above and below the panels
    "least_height": 2.5,
    "most_height": 0.8,  # of the figure's width
    "least_aspect": 0.15,  # of a view that is drawn as it is, height over width
    "most_aspect": 2.2,
    "thumbnail_aspect": 3.0,
    "least_panel_px": 200,
    "thumbnail_px": 240,
    "tile_px": 420,  # a photo among the examples
    "tile": 4.4,
    "tile_heading": 0.3,
    "marker_px": 300,
    "marker_width": 3.2,
    "marker_height": 3.4,
    "section_heading": 0.5,
    "sections_heading": 0.4,
    "sections_a_row": 4,
    "arrow": 0.12,  # of the cameras' distance from the stem: how far a photo's direction is drawn
    "coverage_height": 0.5,  # of the figure's width
    "bar": 0.8,  # of a colour bar beside its panel
}
