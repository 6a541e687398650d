"""The page of `lapwing score --html`, with its scripts running."""
import shutil

from bridge import HERE, ROOT, RUNS, equal, lapwing, node, run_json

LINES = ["Speed, mph", "Steering, degrees", "Offset from the line, m"]


def page(_):
    program, folder = node()
    # Twice, for the charts of a run must not follow those of another.
    runs = [RUNS / "page" / name for name in ("one.mcap", "two.mcap")]
    runs[0].parent.mkdir(parents=True, exist_ok=True)
    for run in runs:
        shutil.copy(ROOT / "recordings" / "lake.mcap", run)
    html = runs[0].with_name("page.html")
    lapwing("score", *runs, "--html", html, "--json")
    result = run_json([program, HERE / "page.js", html], folder)
    equal("charts", [title for title in LINES if title in result["charts"]], LINES)
    return f"{len(result['charts'])} charts a run, {html.stat().st_size // 1024} KiB"
