"""A picture of what was checked: the ring from above with its gaps, and each photo in its place."""

import os

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cherrypicker.capture.look import THUMBNAIL_PX
from cherrypicker.capture.verdict import Verdict
from cherrypicker.files import atomic_path

_COLUMNS, _LINE = 8, 16
_TOP_PX = 360
_PAPER, _INK, _FAINT = "ivory", "black", "darkgrey"
_GOOD, _NOTE, _STOP = "seagreen", "darkorange", "crimson"


def write_contact_sheet(path: str | os.PathLike, tree: str, verdict: Verdict) -> None:
    """Write the sheet as JPEG: photos by azimuth, those of findings framed, red to do again."""
    azimuth = verdict.ring.told_deg
    order = np.argsort(np.where(np.isfinite(azimuth), azimuth, np.inf), kind="stable")
    marks: dict[int, str] = {}  # colours of the photos that findings name
    for finding in reversed(verdict.findings):
        marks |= dict.fromkeys(finding.photos, _STOP if finding.is_stop else _NOTE)
    cell = THUMBNAIL_PX + 2 * _LINE
    n_rows = -(-len(order) // _COLUMNS)
    width = _LINE + _COLUMNS * (THUMBNAIL_PX + _LINE)
    height = _TOP_PX + n_rows * (cell + _LINE) + _LINE
    sheet = Image.new("RGB", (width, height), _PAPER)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=_LINE - 3)
    _draw_ring(draw, verdict, marks)
    title, color = ("go", _GOOD) if verdict.is_go else ("photograph again", _STOP)
    left, top = _TOP_PX + _LINE, 2 * _LINE
    head = f"{tree}: {title}, {len(verdict.looks)} photos"
    draw.text((left, top), head, color, ImageFont.load_default(size=26))
    for number, finding in enumerate(verdict.findings, start=1):
        below = (left, top + 2 * _LINE * number)
        draw.text(below, finding.text, _STOP if finding.is_stop else _NOTE, font)
    for place, row in enumerate(order.tolist()):
        look = verdict.looks[row]
        left = _LINE + place % _COLUMNS * (THUMBNAIL_PX + _LINE)
        top = _TOP_PX + place // _COLUMNS * (cell + _LINE)
        height, width = look.thumbnail.shape[:2]
        corner = (left + (THUMBNAIL_PX - width) // 2, top + (THUMBNAIL_PX - height) // 2)
        sheet.paste(Image.fromarray(look.thumbnail), corner)
        color = marks.get(row, _INK)
        box = [left - 2, top - 2, left + THUMBNAIL_PX + 1, top + THUMBNAIL_PX + 1]
        draw.rectangle(box, outline=marks.get(row, _FAINT), width=4 if row in marks else 1)
        angle = f"{azimuth[row]:.0f} deg" if np.isfinite(azimuth[row]) else "cannot tell"
        draw.text((left, top + THUMBNAIL_PX + 4), f"{look.name}  {angle}", color, font)
        said = f"blur {look.blur:.2f}  marker {', '.join(map(str, look.marker_ids)) or '-'}"
        draw.text((left, top + THUMBNAIL_PX + 4 + _LINE), said, _INK, font)
    with atomic_path(path) as temporary:
        sheet.save(temporary)


def _draw_ring(draw: ImageDraw.ImageDraw, verdict: Verdict, marks: dict) -> None:
    """Draw the ring from above, the first azimuth to the right, counterclockwise."""
    radius = 0.5 * _TOP_PX - 4 * _LINE
    middle = np.array([0.5 * _TOP_PX, 0.5 * _TOP_PX])
    box = [*(middle - radius), *(middle + radius)]
    draw.ellipse(box, outline=_FAINT, width=2)
    for first, last in verdict.gaps:
        draw.arc(box, -last, -first, fill=_STOP, width=10)
    draw.ellipse([*(middle - 6), *(middle + 6)], fill=_INK)
    for row, angle in enumerate(np.radians(verdict.ring.told_deg)):
        if np.isfinite(angle):
            place = middle + radius * np.array([np.cos(angle), -np.sin(angle)])
            draw.ellipse([*(place - 5), *(place + 5)], fill=marks.get(row, _GOOD))
