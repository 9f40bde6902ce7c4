"""Composes rendered images into one picture: panels side by side, titles, labels, outlines and a caption.

It knows pixels and text only; the images come from `sim_mcm.cameras.render`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFilter, ImageFont

Pixels = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Point = tuple[float, float]

MARGIN, TITLE_PX, LINE_PX = 12, 34, 22
INK, PAPER, HALO = (28, 32, 38), (250, 250, 248), (255, 255, 255)
WARNING, OUTLINE = (196, 84, 0), (214, 0, 110)
OUTLINE_PX = 2
JPEG_QUALITY = 80


Sheet = Image.Image  # a composed picture
from_pixels = Image.fromarray


def loaded(file: Path) -> Sheet:
    """Raises OSError."""
    with Image.open(file) as picture:
        picture.load()
        return picture


def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


def outline(mask: Mask, width: int = OUTLINE_PX) -> Mask:
    """The pixels just outside the mask."""
    grown = Image.fromarray(mask.astype(np.uint8)).filter(ImageFilter.MaxFilter(2 * width + 1))
    return np.asarray(grown, dtype=np.bool_) & ~mask


def painted(pixels: Pixels, masks: Sequence[Mask]) -> Pixels:
    """A copy of the image with the outlines of the masks."""
    done = pixels.copy()
    for mask in masks:
        done[outline(mask)] = OUTLINE
    return done


def labelled(pixels: Pixels, labels: Mapping[str, tuple[str, Point]], doubtful: Sequence[str]) -> Image.Image:
    """The image with labels. `labels`: name -> (text, its pixel). A text that would cover another moves down."""
    picture = Image.fromarray(pixels)
    pen = ImageDraw.Draw(picture)
    letters = font(16)
    taken: list[tuple[float, float, float, float]] = []
    for name, (words, (x, y)) in sorted(labels.items(), key=lambda item: item[1][1][1]):
        if not (0 <= x < picture.width and 0 <= y < picture.height):
            continue
        left, top, right, bottom = pen.textbbox((0, 0), words, font=letters)
        wide, high = right - left, bottom - top + 8
        at_x, at_y = min(max(4.0, x - wide / 2), picture.width - wide - 4), max(4.0, y - 34)
        while any(at_x < x1 and at_x + wide > x0 and at_y < y1 and at_y + high > y0 for x0, y0, x1, y1 in taken):
            at_y += high
        taken.append((at_x, at_y, at_x + wide, at_y + high))
        colour = WARNING if name in doubtful else INK
        pen.line([(x, y), (at_x + wide / 2, at_y + high - 2)], fill=colour, width=1)
        pen.ellipse([x - 2, y - 2, x + 2, y + 2], fill=colour)
        pen.text((at_x, at_y), words, font=letters, fill=colour, stroke_width=2, stroke_fill=HALO)
    return picture


def composed(panels: Sequence[tuple[str, Image.Image]], caption: Sequence[str]) -> Image.Image:
    """The panels (title, picture) from left to right, the caption below."""
    wide = sum(picture.width for _, picture in panels) + MARGIN * (len(panels) + 1)
    high = TITLE_PX + panels[0][1].height + MARGIN + (LINE_PX * len(caption) + MARGIN // 2 if caption else 0)
    sheet = Image.new("RGB", (wide, high), PAPER)
    pen = ImageDraw.Draw(sheet)
    x = MARGIN
    for title, picture in panels:
        pen.text((x + 2, 7), title, font=font(18), fill=INK)
        sheet.paste(picture, (x, TITLE_PX))
        x += picture.width + MARGIN
    y = TITLE_PX + panels[0][1].height + MARGIN // 2
    for line in caption:
        pen.text((MARGIN + 2, y), line, font=font(16), fill=INK)
        y += LINE_PX
    return sheet


def captioned(pixels: Pixels, caption: str) -> Image.Image:
    """The image with the lines of a text below it."""
    height, width, _ = pixels.shape
    lines = caption.split("\n")
    whole = Image.new("RGB", (width, height + LINE_PX * len(lines) + 4), PAPER)
    whole.paste(Image.fromarray(pixels), (0, 0))
    for n, line in enumerate(lines):
        ImageDraw.Draw(whole).text((8, height + 4 + n * LINE_PX), line, font=font(15), fill=INK)
    return whole


def save(picture: Image.Image, file: Path) -> None:
    """Write a temporary file and rename it, so that a reader never sees a part of it: JPEG if it is called .jpg, else
    PNG. Raises OSError."""
    beside = file.with_name(f".{file.name}.new")
    try:
        if file.suffix == ".jpg":
            picture.save(beside, format="JPEG", quality=JPEG_QUALITY)
        else:
            picture.save(beside, format="PNG")
        beside.replace(file)
    finally:
        beside.unlink(missing_ok=True)
