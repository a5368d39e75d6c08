"""Gallery of the documentation: thumbnails of finished campaigns, each with the command that draws it.

.venv/bin/python docs/make_gallery.py demo tiny_change basin_tiny

Takes the pictures of results/<campaign> in the order named; a figure that several have is that of the first.
"""

import sys
from itertools import groupby
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "src"))

from thalweg.workflow import read_figures  # noqa: E402

THUMBNAIL_PX = 480
HEAD = """# Gallery

Every figure of the workflow that the examples have, in small, with the command that draws it.
All show the digital twin. Made by `docs/make_gallery.py`; see [all files of a campaign](outputs.md) and
[papers](bibliography.md).
"""


def main(campaigns: list[str]) -> None:
    """Write docs/gallery.md and the thumbnails beside the other pictures."""
    folder = ROOT / "docs/images/gallery"
    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    for row in read_figures(ROOT / "workflow/figures.yaml").rows:
        for campaign in campaigns:
            found = sorted(ROOT.glob(row.path.format(campaign=campaign, scan="*")))
            if row.kind == "study" or not found:
                continue
            with Image.open(found[0]) as picture:
                small = picture.convert("RGB")
                small.thumbnail((THUMBNAIL_PX, THUMBNAIL_PX))
                small.save(folder / f"{row.name}.webp", quality=70, method=6)
            entries.append((row, campaign, found[0].relative_to(ROOT)))
            break
    entries.sort(key=lambda entry: entry[0].category)
    text = [HEAD]
    for category, group in groupby(entries, key=lambda entry: entry[0].category):
        text.append(f"## {category}\n")
        for row, campaign, path in group:
            text.append(
                f"![{row.shows}](images/gallery/{row.name}.webp)\n\n{row.shows} "
                f"`snakemake {path} --config campaign={campaign}`\n"
            )
    (ROOT / "docs/gallery.md").write_text("\n".join(text), encoding="utf-8")
    print(f"{len(entries)} figures")


if __name__ == "__main__":
    main(sys.argv[1:])
