"""The picture of docs/wishes.md: `python docs/site/make_sheet.py`, from the pictures of the gallery."""

from __future__ import annotations

from pathlib import Path

import matplotlib
from make_gallery import FOLDER, ROOT
from PIL import Image, ImageDraw, ImageFont

SHEET = ROOT / "docs" / "images" / "wishes.png"
SIZE, COLUMNS = (296, 171), 4  # [pixel] of a picture
SHOWN = (0, 0, 840, 486)  # [pixel] of one in the gallery: all but the bar
CAPTION = 26  # [pixel]
WISHES = {
    "arms-reach_pose": "a pose of the tool",
    "arms-cup": "a cup stays upright",
    "arms-slalom": "around obstacles",
    "arms-throw_into_bucket": "throw, and hit",
    "arms-dual_arm_box": "two arms, one load",
    "free_flyer-gates": "through gates, fast",
    "walking-compass_gait": "walk with least effort",
    "loops-stewart": "closed loops",
}


def main() -> None:
    """Write the sheet."""
    rows = -(-len(WISHES) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * SIZE[0], rows * (SIZE[1] + CAPTION)), "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.truetype(Path(matplotlib.get_data_path(), "fonts/ttf/DejaVuSans.ttf"), 14)
    for number, (name, words) in enumerate(WISHES.items()):
        row, column = divmod(number, COLUMNS)
        x, y = column * SIZE[0], row * (SIZE[1] + CAPTION)
        with Image.open(FOLDER / f"{name}.png") as picture:
            sheet.paste(picture.convert("RGB").crop(SHOWN).resize(SIZE, Image.Resampling.LANCZOS), (x, y))
        draw.text((x + 8, y + SIZE[1] + 4), words, fill=(31, 41, 51), font=font)
    sheet.quantize(160, dither=Image.Dither.NONE).save(SHEET, optimize=True)
    print(SHEET)


if __name__ == "__main__":
    main()
