#!/usr/bin/env python3
"""Makes the pictures of the README: docs/images/drive.webp, which moves through a drive, its page and its scorecard, and
docs/images/scorecard.png.

    scripts/moving_picture.py

Needs `target/release/lapwing`, Node.js with npm, and Chromium; packages of PyPI and npm go to `target/interop/`, as for
the interop tests. The frames are those of a film (`drive --video`), of the live page (`drive --page`), and of the report
(`score --html`) while the pointer moves along a curve.
"""
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "interop"))
from bridge import ENVIRONMENT, LAPWING, WORK, node, python, wait_for  # noqa: E402
from checks_live import browser  # noqa: E402

OUT = ROOT / "docs" / "images" / "drive.webp"
STILL = OUT.with_name("scorecard.png")
# GitHub shows a README about as wide.
SIZE = (720, 405)
# Of a film of 15 frames a second, every second one; the pages are pictured as often.
FRAME_MS = 133
QUALITY = 52
LARGEST = 2_000_000

COMPOSE = f"""
import sys
from pathlib import Path
from PIL import Image
scorecard, still, out, *paths = map(Path, sys.argv[1:])
frames = [Image.open(path).convert("RGB").resize({SIZE}, Image.Resampling.LANCZOS) for path in paths]
frames[0].save(out, save_all=True, append_images=frames[1:], duration={FRAME_MS}, loop=0, quality={QUALITY}, method=6)
Image.open(scorecard).convert("RGB").quantize(256).save(still, optimize=True)
"""


def drive(folder, *arguments):
    subprocess.run([LAPWING, "drive", "--speed", "20", *map(str, arguments)], cwd=folder, env=ENVIRONMENT, check=True,
                   stdout=subprocess.DEVNULL)


def main():
    program, packages = node()
    folder = WORK / "moving"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    # From where the road bends on.
    drive(folder, "--max-time", "21", "--no-recording", "--video", folder / "film")
    film = sorted((folder / "film").glob("*.jpg"))[-75::2]
    drive(folder, "--laps", "1", "--recordings", folder / "runs")
    subprocess.run([LAPWING, "score", "runs", "--html", "report.html"], cwd=folder, env=ENVIRONMENT, check=True,
                   stdout=subprocess.DEVNULL)
    with open(folder / "log", "wb") as log:
        page = subprocess.Popen([LAPWING, "drive", "--speed", "20", "--page", "0", "--no-recording"], cwd=folder,
                                env=ENVIRONMENT, stdout=log, stderr=log)
    try:
        address = r"Page: (http://127\.0\.0\.1:\d+/)"
        found = wait_for("the page's address", 60, lambda: re.search(address, (folder / "log").read_text()))
        browser()
        capture = [program, ROOT / "scripts" / "moving_picture.js", found[1], folder / "report.html", folder, FRAME_MS]
        subprocess.run([str(part) for part in capture], cwd=packages, env=ENVIRONMENT, check=True)
    finally:
        page.terminate()
        page.wait(20)
    pages = [path for name in ("page", "report") for path in sorted(folder.glob(f"{name}-*.png"))]
    subprocess.run([python("perception"), "-c", COMPOSE, folder / "scorecard.png", STILL, OUT, *film, *pages], check=True)
    size = OUT.stat().st_size
    if size > LARGEST:
        sys.exit(f"{OUT}: expected at most {LARGEST} bytes, got {size}")
    print(f"{OUT.relative_to(ROOT)}: {len(film) + len(pages)} frames, {size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
