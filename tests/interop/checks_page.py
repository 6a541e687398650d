"""The report of `lapwing score --html`, the page of `lapwing suite` and a film of `lapwing drive`, in a real browser."""
from bridge import HERE, RUNS, equal, lapwing, node, run_json
from checks_live import browser

# The longest time is too short for a lap of the jungle, so that cells fail. The page begins in the order of names;
# the second pilot keeps nearer to the line, so that sorting moves it.
SUITE = """
tracks = ["lake", "jungle"]
conditions = ["fair", "noise=4"]
speeds_mph = [20]
seeds = 2
longest_s = 20

[[pilot]]
name = "a network"

[[pilot]]
name = "the expert"
expert = true
"""


def report(_):
    """Its screenshots lie in `target/interop/runs/report`."""
    program, folder = node()
    browser()
    here = RUNS / "report"
    here.mkdir(parents=True, exist_ok=True)
    drive = ("drive", "--max-time", "30", "--recordings", here / "mcap", "--json")
    lapwing(*drive, "--speed", "20")
    lapwing(*drive, "--speed", "15", "--pilot", "expert", "--video", here / "film.mp4")
    lapwing("score", here / "mcap", "--html", here / "report.html", "--json")
    (here / "suite.toml").write_text(SUITE)
    lapwing("suite", here / "suite.toml", "--out", here / "suite", "--json")
    kept = {run.suffix for run in (here / "suite" / "runs").iterdir()}
    equal("beside each other in the suite's runs", kept, {".mcap", ".html"})
    pages = (here / "report.html", here / "suite" / "suite.html", here / "film.mp4")
    result = run_json([program, HERE / "report.js", *pages, here], folder, timeout=420)
    sizes = [page.stat().st_size // 1024 for page in pages]
    return (f"{result['charts']} charts under one cursor; report {sizes[0]} KiB, suite {sizes[1]} KiB, "
            f"film of {result['film']['seconds']:.0f} s {sizes[2]} KiB")
