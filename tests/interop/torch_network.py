"""Saves a network of torch.nn.Sequential as safetensors and as TorchScript, and answers pictures with it: a child of
checks_models.py, in an environment with requirements-torch.txt.

    torch_network.py DATA OUT

OUT gets weights.safetensors, net.pt and answers.json, as keras_network.py makes them. The network is PilotNet, untrained, on
Pillow's pictures: rows 60 to 134, BILINEAR to 200x66, YCbCr, -1 to 1.
"""
import csv
import json
import sys
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from safetensors.torch import save_file
from torch import nn

data, out = map(Path, sys.argv[1:])
with open(data / "driving_log.csv") as log:
    rows = [row for row in csv.reader(log, skipinitialspace=True) if row and not row[0].startswith("center")]


def picture(row):
    image = Image.open(data / "IMG" / Path(row[0].replace("\\", "/")).name).convert("RGB").crop((0, 60, 320, 135))
    pixels = np.asarray(image.resize((200, 66), Image.Resampling.BILINEAR).convert("YCbCr"), np.float32)
    return torch.from_numpy(pixels).permute(2, 0, 1) / 127.5 - 1


torch.manual_seed(1)
network = nn.Sequential(
    nn.Conv2d(3, 24, 5, 2), nn.ELU(), nn.Conv2d(24, 36, 5, 2), nn.ELU(), nn.Conv2d(36, 48, 5, 2), nn.ELU(),
    nn.Conv2d(48, 64, 3), nn.ELU(), nn.Conv2d(64, 64, 3), nn.ELU(), nn.Flatten(),
    nn.Linear(1152, 100), nn.ELU(), nn.Linear(100, 50), nn.ELU(), nn.Linear(50, 10), nn.ELU(), nn.Linear(10, 1),
).eval()
with torch.no_grad():
    for layer in network:  # answers that vary from picture to picture, without a training
        if hasattr(layer, "weight"):
            layer.weight.mul_(1.5)
    save_file(network.state_dict(), out / "weights.safetensors")
    torch.jit.trace(network, picture(rows[0])[None]).save(str(out / "net.pt"))
    torch.save(network.state_dict(), out / "net.pth")
    answers = [float(network(picture(row)[None])) for row in rows[:30]]
(out / "answers.json").write_text(json.dumps(answers))
