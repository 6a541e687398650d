#!/usr/bin/env python3
"""What OpenCV and Pillow make of pictures that any language can draw: the answers that the tests of `crates/core` compare
with, byte for byte.

    tests/interop/perception_answers.py            compare with the file that is committed
    tests/interop/perception_answers.py --write    write it again

Needs the packages of requirements-perception.txt. Pictures are `drawn` below; an answer is the SHA-256 of its bytes, and of
small ones the bytes themselves.
"""
import hashlib
import json
import sys
from pathlib import Path

import cv2
import numpy as np
import PIL
from PIL import Image

FILE = Path(__file__).resolve().parents[2] / "crates/core/src/perception/answers.json"
CV2 = {"cv2-nearest": cv2.INTER_NEAREST, "cv2-linear": cv2.INTER_LINEAR, "cv2-cubic": cv2.INTER_CUBIC,
       "cv2-area": cv2.INTER_AREA}
PILLOW = {"pillow-nearest": Image.Resampling.NEAREST, "pillow-box": Image.Resampling.BOX,
          "pillow-bilinear": Image.Resampling.BILINEAR, "pillow-bicubic": Image.Resampling.BICUBIC,
          "pillow-lanczos": Image.Resampling.LANCZOS}
# Width and height of the picture and of what it becomes: as the known networks do, whole factors, larger, and both at once.
SIZES = [((320, 75), (200, 66)), ((320, 160), (64, 64)), ((320, 160), (160, 80)), ((320, 160), (80, 40)),
         ((320, 90), (200, 66)), ((40, 30), (64, 64)), ((320, 60), (200, 66)), ((32, 16), (20, 9)), ((7, 5), (3, 4))]


def drawn(width, height):
    """Noise, the hardest of pictures, over a slope that makes ties: Numerical Recipes' generator, from 1."""
    state, out = 1, np.zeros(width * height * 3, np.uint8)
    for i in range(out.size):
        state = (state * 1664525 + 1013904223) & 0xFFFFFFFF
        x = i // 3 % width
        out[i] = (state >> 24) if i // 3 // width % 2 else (x * 255 // width + (state >> 30)) & 255
    return out.reshape(height, width, 3)


def colours():
    """Each fifth level of red, green and blue, in all combinations, as one row."""
    levels = np.arange(0, 256, 5, dtype=np.uint8)
    return np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), -1).reshape(1, -1, 3)


def answer(pixels):
    raw = np.ascontiguousarray(pixels).tobytes()
    found = {"sha256": hashlib.sha256(raw).hexdigest()}
    if len(raw) <= 600:
        found["bytes"] = raw.hex()
    return found


def answers():
    # As OpenCV itself does it. Wheels for x86 take Intel's IPP for INTER_CUBIC instead, which differs by a level here and there.
    cv2.ipp.setUseIPP(False)
    resized, blurred, coloured = [], [], []
    for (width, height), to in SIZES:
        picture = drawn(width, height)
        for name, filter in CV2.items():
            resized.append({"from": [width, height], "to": to, "filter": name, **answer(cv2.resize(picture, to, interpolation=filter))})
        for name, filter in PILLOW.items():
            of = np.asarray(Image.fromarray(picture).resize(to, filter))
            resized.append({"from": [width, height], "to": to, "filter": name, **answer(of)})
    for side in (3, 5, 7):
        for size in ((320, 75), (13, 11)):
            picture = cv2.GaussianBlur(drawn(*size), (side, side), 0)
            blurred.append({"from": size, "blur": f"gaussian-{side}x{side}", **answer(picture)})
    rgb, hsv = colours(), cv2.cvtColor(colours(), cv2.COLOR_RGB2HSV)
    of_pillow = lambda mode: np.asarray(Image.fromarray(rgb).convert(mode))
    for name, pixels in {
        "bgr": cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), "cv2-yuv": cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV),
        "cv2-yuv-3.1": cv2.cvtColor(rgb, cv2.COLOR_BGR2YUV), "cv2-grey": cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY),
        "cv2-hsv": hsv, "cv2-saturation": hsv[..., 1], "pillow-ycbcr": of_pillow("YCbCr"), "pillow-grey": of_pillow("L"),
    }.items():
        coloured.append({"colour": name, **answer(pixels)})
    return {"made_by": f"OpenCV {cv2.__version__}, Pillow {PIL.__version__}", "resized": resized, "blurred": blurred,
            "coloured": coloured}


def main():
    found = answers()
    if "--write" in sys.argv[1:]:
        FILE.write_text(json.dumps(found, indent=1) + "\n")
        return 0
    known = json.loads(FILE.read_text())
    same = json.loads(json.dumps(found))
    differ = [a for kind in ("resized", "blurred", "coloured") for a, b in zip(known[kind], same[kind]) if a != b]
    for each in differ:
        print(f"differs: {each}")
    count = sum(len(known[kind]) for kind in ("resized", "blurred", "coloured"))
    print(f"{count - len(differ)} of {count} answers of {same['made_by']} are those of {known['made_by']}")
    return 1 if differ else 0


if __name__ == "__main__":
    sys.exit(main())
