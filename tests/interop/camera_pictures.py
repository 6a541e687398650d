"""What keras_network.py and torch_network.py do alike: the rows of a driving_log.csv, and a picture prepared as many solutions
of Udacity's project do it: rows 60 to 134, cv2's INTER_AREA to 200x66, RGB2YUV."""
import csv
from pathlib import Path

import cv2
import numpy as np


def rows(data):
    """Each picture of a data set, and what was steered."""
    with open(data / "driving_log.csv") as log:
        cells = [row for row in csv.reader(log, skipinitialspace=True) if row and not row[0].startswith("center")]
    return [(data / "IMG" / Path(row[0].replace("\\", "/")).name, float(row[3])) for row in cells]


def rgb(path):
    return cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)


def yuv(path):
    """A picture as the network takes it, still 0 to 255: (66, 200, 3) u8."""
    return cv2.cvtColor(cv2.resize(rgb(path)[60:135], (200, 66), interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2YUV)


def decoded(folder):
    """The pictures that Lapwing decoded, in order."""
    with open(folder / "answers.csv") as table:
        return [folder / row["picture"] for row in csv.DictReader(table)]


def decoders(jpegs, pngs):
    """How OpenCV's JPEG decoder differs from Lapwing's: the share of the levels that do, and by how many at most."""
    apart = np.stack([np.abs(rgb(jpeg).astype(int) - rgb(png)) for jpeg, png in zip(jpegs, pngs, strict=True)])
    return {"differ": float((apart > 0).mean()), "most": int(apart.max())}
