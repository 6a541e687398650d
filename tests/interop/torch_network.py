"""Trains a network of NVIDIA's kind in PyTorch for a moment, saves it in each way that Lapwing reads, and answers pictures with it: a
child of checks_models.py, in an environment with requirements-torch.txt and PyTorch.

    torch_network.py DATA DECODED OUT

DATA has driving_log.csv and IMG/, DECODED its first pictures as `lapwing model check --pictures` writes them. OUT gets
weights.safetensors, scripted.pt, traced.pt, net.onnx; two.onnx, whose weights are in a second file, as torch.onnx.export writes it
unless told otherwise; and answers.json: the steering for the pictures in DECODED, and for the same pictures as OpenCV decodes their
JPEG files.
"""
import json
import sys
import warnings
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file
from torch import nn

from camera_pictures import decoded, decoders, rows, yuv

data, pngs, out = Path(sys.argv[1]), decoded(Path(sys.argv[2])), Path(sys.argv[3])
jpegs, steering = zip(*rows(data))


def prepared(paths):
    """(B, 3, 66, 200) f32 in [-1, 1]."""
    return torch.from_numpy(np.stack([yuv(path) for path in paths])).permute(0, 3, 1, 2) / 127.5 - 1


pictures, steering = prepared(jpegs), torch.tensor(steering).reshape(-1, 1)

torch.manual_seed(1)
network = nn.Sequential(
    nn.Conv2d(3, 24, 5, stride=2), nn.ELU(),
    nn.Conv2d(24, 36, 5, stride=2), nn.ELU(),
    nn.Conv2d(36, 48, 5, stride=2), nn.ELU(),
    nn.Conv2d(48, 64, 3), nn.ELU(),
    nn.Conv2d(64, 64, 3), nn.ELU(),
    nn.Flatten(), nn.Dropout(0.1),
    nn.Linear(1152, 100), nn.ELU(),
    nn.Linear(100, 50), nn.ELU(),
    nn.Linear(50, 10), nn.ELU(),
    nn.Linear(10, 1),
)
optimizer, losses = torch.optim.Adam(network.parameters(), lr=1e-3), []
for epoch in range(4):
    total = 0.0
    for batch in torch.randperm(len(pictures)).split(32):
        loss = nn.functional.mse_loss(network(pictures[batch]), steering[batch])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        total += loss.item() * len(batch)
    losses.append(total / len(pictures))

network.eval()  # or Dropout goes on leaving values out
example = torch.zeros(1, 3, 66, 200)
save_file(network.state_dict(), out / "weights.safetensors")
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of what PyTorch will do one day
    torch.jit.script(network).save(out / "scripted.pt")
    torch.jit.trace(network, example).save(out / "traced.pt")
    torch.onnx.export(network, (example,), out / "net.onnx", external_data=False, verbose=False)
    torch.onnx.export(network, (example,), out / "two.onnx", verbose=False)

with torch.no_grad():
    answers = {"png": network(prepared(pngs)), "jpeg": network(pictures[:len(pngs)])}
told = {"version": torch.__version__, "loss": losses, "decoders": decoders(jpegs[:len(pngs)], pngs),
        "answers": {pixels: steered[:, 0].tolist() for pixels, steered in answers.items()}}
(out / "answers.json").write_text(json.dumps(told))
