#!/usr/bin/env python3
"""What learning costs in PyTorch: the peer of `benches/training.rs`, on the CPU.

PilotNet learns as `lapwing train` has it learn by default: pictures in memory, decoded and resized so that rows
60 to 135 are 66x200, Lu's five augmentations with Lu's ranges at that size, YUV from -1 to 1, batches of 64, mean squared error, Adam. Measured in
images a second: the step alone on a tensor in memory, the DataLoader alone, and training with the DataLoader, each in
several settings, of which the best counts. It is run by hand, because PyTorch takes 5 GB:

    python3 -m venv .venv-torch
    .venv-torch/bin/pip install torch==2.13.0 numpy opencv-python-headless
    .venv-torch/bin/python benches/dataloader.py            # and once more with --bf16
    cargo bench -- training                                 # same machine, same hour

Without `--data DIR` (a folder with driving_log.csv and IMG/) both look at the same kind of generated picture.

Where the two differ, PyTorch has it easier: OpenCV resizes bilinearly without antialiasing (Lapwing antialiases),
YUV is rounded to bytes before it is scaled (Lapwing's is not), epochs never end, and nobody asks for the loss.

The settings of the loader:
    samples   the ordinary one: a sample at a time, bytes, gathered by PyTorch's own collate; scaled beside the step
    batches   a batch at a time, as bytes, straight into memory shared by all processes; scaled beside the step
    ready     the same, but scaled by the worker, in the precision of the step

All of these have what PyTorch offers for speed: channels last, fused Adam, glibc told to keep its memory. `--plain` has
none of it: an ordinary script, for `--settings samples --workers 2`.
"""
import argparse
import csv
import os
import re
import statistics
import sys
import tempfile
import time
import warnings
from pathlib import Path

# What Lapwing asks of glibc (`nn::keep_tensor_memory`): memory once had is kept. Read at the start of a process only.
MALLOC = {
    "MALLOC_TRIM_THRESHOLD_": str(2**31 - 1),
    "MALLOC_MMAP_THRESHOLD_": str(2**31 - 1),
    "MALLOC_TOP_PAD_": str(64 << 20),
}
PLAIN = "--plain" in sys.argv
if not PLAIN and any(os.environ.get(name) != value for name, value in MALLOC.items()):
    os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **MALLOC})

import cv2
import numpy as np
import torch
from torch import nn
from torch.utils.data import DataLoader, Dataset, Sampler, get_worker_info

BATCH = 64
HEIGHT, WIDTH = 160, 320
TOP, BOTTOM = 60, 135
INPUT = (66, 200)
# The strip that is kept of a picture, as Lapwing keeps it: the crop and what a shift brings in, at the network's size.
REACH = 20
ROWS = round((BOTTOM - TOP + 2 * REACH) * INPUT[0] / (BOTTOM - TOP))
ACROSS, DOWN = WIDTH / INPUT[1], (BOTTOM - TOP) / INPUT[0]
SIDE_OFFSET = 0.25
PREFETCH = 2


# --- the data ---------------------------------------------------------------------------------------------------------


def generate(folder: Path, rows: int = 640) -> None:
    """A road under a sky with some noise: the picture of benches/driving.rs, as often as benches/training.rs has it."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    road = np.abs(x - 160) < y - 50
    sky = np.stack([120 + y, 160 + y, 0 * y + 230], -1)
    tar = np.stack([110 - y // 4, 105 - y // 4, 100 - y // 4], -1)
    grass = np.stack([60 + x // 8, 110 + y // 4, 0 * y + 40], -1)
    rgb = np.where(road[..., None], tar, grass)
    rgb[:60] = sky[:60]
    rgb += np.random.default_rng(1).integers(-18, 18, (HEIGHT, WIDTH, 1))
    bgr = rgb.clip(0, 255).astype(np.uint8)[..., ::-1]
    _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 75])
    (folder / "IMG").mkdir()
    with open(folder / "driving_log.csv", "w") as log:
        for row in range(rows):
            (folder / f"IMG/{row}.jpg").write_bytes(jpeg.tobytes())
            log.write(f"{row}.jpg,,,{np.sin(row * 0.1)},0.5,0,15\n")


def read(folder: Path, cache_mib: int) -> tuple[list[np.ndarray | bytes], np.ndarray]:
    """Pictures and steering of the rows that are learnt from. As many pictures are decoded as there is room for, the
    others stay as they are and are decoded each time."""
    pictures, steering = [], []
    room = cache_mib << 20
    with open(folder / "driving_log.csv", newline="") as log:
        rows = [row for row in csv.reader(log) if len(row) > 3 and re.match(r"\s*[-+.\d]", row[3])]
    for number, row in enumerate(rows):
        if (number // 50) % 5 == 0:
            continue  # held out, to measure by
        for path, offset in zip(row, (0.0, SIDE_OFFSET, -SIDE_OFFSET)):
            name = re.split(r"[/\\]", path.strip())[-1]
            if not name:
                continue
            picture = (folder / "IMG" / name).read_bytes()
            if room >= ROWS * INPUT[1] * 3:
                picture = decode(picture)
                room -= picture.nbytes
            pictures.append(picture)
            steering.append(float(row[3].replace(",", ".")) + offset)
    return pictures, np.array(steering, np.float32)


def decode(jpeg: bytes) -> np.ndarray:
    bgr = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)  # (160, 320, 3) u8
    if bgr is None or bgr.shape != (HEIGHT, WIDTH, 3):
        raise ValueError(f"expected pictures of {WIDTH}x{HEIGHT}, got {None if bgr is None else bgr.shape}")
    # Once, and not for each draw: rows 40 to 155 at the scale at which 60 to 135 are the network's 66.
    return cv2.resize(bgr[TOP - REACH : BOTTOM + REACH], (INPUT[1], ROWS), interpolation=cv2.INTER_LINEAR)


def augment(frame: np.ndarray, steering: float, random: np.random.Generator) -> tuple[np.ndarray, float]:
    """What the network sees of a strip of 101x200, changed there as `src/dataset/augment.rs` does it, each change with
    probability 0.5 and Lu's ranges, which are of the recorded picture."""
    dice = random.random(16).tolist()
    flip, translate, brighten, shade, erase = (die < 0.5 for die in dice[:5])
    right, down = (round((-60 + 120 * dice[5]) / ACROSS), round((-20 + 40 * dice[6]) / DOWN)) if translate else (0, 0)
    height, width = INPUT
    above = (ROWS - height) // 2
    top = min(max(above - down, 0), ROWS - height)
    rows = frame[top : top + height]  # (66, 200, 3); the shift never leaves the strip
    if flip:
        rows, steering = cv2.flip(rows, 1), -steering
    if right:
        left, kept = max(right, 0), rows[:, max(-right, 0) : width - max(right, 0)]
        rows = cv2.copyMakeBorder(kept, 0, 0, left, max(-right, 0), cv2.BORDER_REPLICATE)
        steering += right * ACROSS * 0.003
    if brighten:
        rows = cv2.convertScaleAbs(rows, alpha=0.3 + 1.3 * dice[7])
    if (shade or erase) and not (flip or right or brighten):
        rows = rows.copy()  # the picture itself stays as it is
    if shade:
        a, b, c, d = (round(width * die) for die in dice[8:12])
        mask = np.zeros((height, width), np.uint8)
        # Lines that cross make two triangles: fillPoly goes by even and odd.
        cv2.fillPoly(mask, [np.array([(a, 0), (b, 0), (c, height), (d, height)], np.int32)], 255)
        cv2.copyTo(cv2.convertScaleAbs(rows, alpha=0.6 + 0.25 * dice[12]), mask, rows)
    if erase:
        area = (0.02 + 0.38 * dice[13]) * height * width
        ratio = 0.5 * 5 ** dice[14] * ACROSS / DOWN  # 0.5 to 2.5 as recorded, as likely tall as wide
        tall = min(max(round((area * ratio) ** 0.5), 1), height)
        wide = min(max(round(area / tall), 1), width)
        x, y = round((width - wide) * dice[15]), round((height - tall) * random.random())
        rows[y : y + tall, x : x + wide] = 0
    return rows, steering


class Samples(Dataset):
    """A sample at a time: (66, 200, 3) u8 in YUV, and its steering."""

    def __init__(self, pictures, steering):
        self.pictures, self.steering = pictures, steering
        self.random = np.random.default_rng(0)

    def make(self, index: int, out: np.ndarray) -> float:
        frame = self.pictures[index]
        frame = decode(frame) if isinstance(frame, bytes) else frame
        rows, steering = augment(frame, self.steering[index].item(), self.random)
        cv2.cvtColor(rows, cv2.COLOR_BGR2YUV, dst=out)
        return steering

    def __getitem__(self, index):
        out = np.empty((*INPUT, 3), np.uint8)
        steering = self.make(index, out)
        return torch.from_numpy(out), np.float32(steering)


class Batches(Samples):
    """A batch at a time, into a ring of batches that all processes share. What travels is the number of its place."""

    def __init__(self, pictures, steering, slots: int, kind: torch.dtype):
        super().__init__(pictures, steering)
        self.frames = torch.empty((slots, BATCH, *INPUT, 3), dtype=kind).share_memory_()
        self.labels = torch.empty((slots, BATCH)).share_memory_()
        self.bytes = torch.empty((BATCH, *INPUT, 3), dtype=torch.uint8)
        self.scaled = torch.empty((BATCH, *INPUT, 3))

    def __getitems__(self, keys):
        slot, indices = keys[0], keys[1:]
        frames = self.frames[slot]
        target = (frames if frames.dtype == torch.uint8 else self.bytes).numpy()
        for place, index in enumerate(indices):
            self.labels[slot, place] = self.make(index, target[place])
        if frames.dtype != torch.uint8:
            scaled = frames if frames.dtype == torch.float32 else self.scaled
            scaled.copy_(self.bytes).mul_(1 / 127.5).sub_(1)
            if scaled is not frames:
                frames.copy_(scaled)
        return slot


class Endless(Sampler):
    """Batches of indices, drawn with replacement. Begins each with a place in a ring if there is one."""

    def __init__(self, samples: int, slots: int = 0):
        self.samples, self.slots = samples, slots

    def __iter__(self):
        random, number = np.random.default_rng(0), 0
        while True:
            indices = random.integers(self.samples, size=BATCH).tolist()
            yield [number % self.slots, *indices] if self.slots else indices
            number += 1


def start_worker(_):
    torch.set_num_threads(1)
    cv2.setNumThreads(0)
    info = get_worker_info()
    info.dataset.random = np.random.default_rng(info.seed)


def itself(batch):
    return batch


def batches(data, setting: str, workers: int, kind: torch.dtype):
    """Endlessly (64, 66, 200, 3) and (64). Bytes, or numbers from -1 to 1 if the setting is `ready`."""
    # At most workers * PREFETCH batches are under way while one is in use.
    slots = 0 if setting == "samples" else workers * PREFETCH + 1
    if slots:
        dataset = Batches(*data, slots, kind if setting == "ready" else torch.uint8)
    else:
        dataset = Samples(*data)
    loader = DataLoader(
        dataset,
        batch_sampler=Endless(len(data[0]), slots),
        collate_fn=itself if slots else None,
        num_workers=workers,
        worker_init_fn=start_worker,
        persistent_workers=workers > 0,
        prefetch_factor=PREFETCH if workers else None,
        multiprocessing_context="fork" if workers else None,
    )
    for batch in loader:
        yield (dataset.frames[batch], dataset.labels[batch]) if slots else batch


# --- the network ------------------------------------------------------------------------------------------------------


def pilotnet() -> nn.Module:
    """Bojarski et al. 2016, with ELU: as src/nn/pilotnet.rs."""
    layers = []
    convolutions = [(24, 3, 5, 2), (36, 24, 5, 2), (48, 36, 5, 2), (64, 48, 3, 1), (64, 64, 3, 1)]
    for outputs, inputs, kernel, stride in convolutions:
        layers += [nn.Conv2d(inputs, outputs, kernel, stride), nn.ELU()]
    layers += [nn.Flatten()]
    for outputs, inputs in [(100, 1152), (50, 100), (10, 50)]:
        layers += [nn.Linear(inputs, outputs), nn.ELU()]
    return nn.Sequential(*layers, nn.Linear(10, 1))


class Trainer:
    def __init__(self, kind: torch.dtype, compiled: bool):
        torch.manual_seed(0)
        network = pilotnet()
        if not PLAIN:
            network = network.to(memory_format=torch.channels_last)
        assert sum(weight.numel() for weight in network.parameters()) == 252_219
        self.kind = kind
        self.optimiser = torch.optim.Adam(network.parameters(), lr=1e-3, fused=not PLAIN or None)
        self.network = torch.compile(network) if compiled else network

    def learn(self, frames: torch.Tensor, labels: torch.Tensor) -> None:
        frames = frames.permute(0, 3, 1, 2)  # (64, 3, 66, 200), channels last in memory as it comes
        if frames.dtype == torch.uint8:
            frames = frames.float().mul_(1 / 127.5).sub_(1)
        if PLAIN:
            frames = frames.contiguous()
        self.optimiser.zero_grad(set_to_none=True)
        with torch.autocast("cpu", torch.bfloat16, enabled=self.kind == torch.bfloat16):
            answer = self.network(frames)
        nn.functional.mse_loss(answer.float().squeeze(1), labels).backward()
        self.optimiser.step()


# --- the clock --------------------------------------------------------------------------------------------------------


class Clock:
    def __init__(self, seconds: float, rounds: int):
        self.seconds, self.rounds = seconds, rounds
        self.results: dict[str, list[tuple[float, str]]] = {}

    def measure(self, what: str, setting: str, turn) -> None:
        """`turn` makes a batch. Warmed up for a third of the time, then in rounds."""
        turn()  # starts the workers
        self.run(turn, self.seconds / 3)
        rates = [self.run(turn, self.seconds / self.rounds) for _ in range(self.rounds)]
        median = statistics.median(rates)
        self.results.setdefault(what, []).append((median, setting))
        print(f"{what:<15} {setting:<34} {median:8.0f} {max(rates):8.0f}", flush=True)

    def run(self, turn, seconds: float) -> float:
        """Images a second."""
        turns, begin = 0, time.perf_counter()
        while time.perf_counter() - begin < seconds:
            turn()
            turns += 1
        return turns * BATCH / (time.perf_counter() - begin)


def main() -> None:
    about, _, rest = __doc__.partition("\n")
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=about, epilog=rest, formatter_class=raw)
    parser.add_argument("--data", type=Path, help="folder with driving_log.csv and IMG/ (default: a generated one)")
    parser.add_argument("--cache-mib", type=int, default=819, help="decoded pictures (default 819, as Lapwing)")
    parser.add_argument("--bf16", action="store_true", help="autocast to bfloat16")
    parser.add_argument("--plain", action="store_true", help="PyTorch's own defaults throughout, see below")
    parser.add_argument("--compile", action="store_true", help="torch.compile the network; wants a C++ compiler")
    parser.add_argument("--workers", type=int, nargs="+", default=[0, 1, 2, 3], help="num_workers (default 0 1 2 3)")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="torch's threads (default 1 2)")
    settings = ["samples", "batches", "ready"]
    parser.add_argument("--settings", nargs="+", choices=settings, default=settings, help="of the loader, see below")
    parser.add_argument("--seconds", type=float, default=3.0, help="a measurement, after warming up (default 3)")
    parser.add_argument("--rounds", type=int, default=6, help="that these are divided into (default 6)")
    args = parser.parse_args()
    kind = torch.bfloat16 if args.bf16 else torch.float32
    cv2.setNumThreads(0)
    warnings.filterwarnings("ignore", "This DataLoader will create")  # more workers than cores are tried on purpose

    with tempfile.TemporaryDirectory() as folder:
        if args.data is None:
            generate(Path(folder))
        data = read(args.data or Path(folder), args.cache_mib)
    versions = f"PyTorch {torch.__version__}, OpenCV {cv2.__version__}"
    print(f"{versions}, {os.cpu_count()} processors, {len(data[0])} pictures")
    print(f"{'images/s, ' + str(kind).removeprefix('torch.'):<50} {'median':>8} {'best':>8}")

    clock = Clock(args.seconds, args.rounds)
    frames, labels = next(batches(data, "ready", 0, kind))
    for threads in args.threads:
        torch.set_num_threads(threads)
        trainer = Trainer(kind, args.compile)
        clock.measure("step in memory", f"threads {threads}", lambda: trainer.learn(frames, labels))
    for setting in args.settings:
        for workers in args.workers:
            torch.set_num_threads(1)
            stream = batches(data, setting, workers, kind)
            clock.measure("loader alone", f"{setting}, workers {workers}", lambda: next(stream))
            stream.close()
            for threads in args.threads:
                torch.set_num_threads(threads)
                trainer, stream = Trainer(kind, args.compile), batches(data, setting, workers, kind)
                turn = lambda: trainer.learn(*next(stream))
                clock.measure("training", f"{setting}, workers {workers}, threads {threads}", turn)
                stream.close()

    best = {what: max(results) for what, results in clock.results.items()}
    print("\nbest by the median:")
    for what, (rate, setting) in best.items():
        print(f"{what:<15} {setting:<34} {rate:8.0f}")
    print(f"training reaches {best['training'][0] / best['step in memory'][0]:.0%} of the step in memory")


if __name__ == "__main__":
    main()
