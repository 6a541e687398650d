"""Ordinary Socket.IO clients of both protocol generations, by every way in."""
from bridge import HERE, Bridge, equal, jpeg_file, node, python, run_json, wait_for

ROUNDS = 20
# The way in, and the transport that the client must end up with.
WAYS = {"polling": "polling", "websocket": "websocket", "upgrade": "websocket"}


def python_socketio(_):
    clients = {f"v{major}": [python(f"socketio-{major}"), HERE / "python_client.py"] for major in (5, 4)}
    return play(clients)


def js_socketio(_):
    program, folder = node()
    return play({f"v{major}": [program, HERE / "js_client.js", major] for major in (4, 2)}, folder)


def play(clients, cwd=None):
    """Each client by each way to one bridge, which must tell of every drive when it ends."""
    figures = []
    with Bridge() as bridge:
        for name, command in clients.items():
            for way, transport in WAYS.items():
                result = run_json([*command, bridge.port, way, jpeg_file(), ROUNDS], cwd)
                equal(f"{name} {way}: transport in the end", result["transport"], transport)
                figures.append(f"{name} {way} {result['rtt_p50_ms']} ms")
                # python-socketio 4 over polling may leave without a word; the missing heartbeat tells then, after 20 s.
                wait_for(f"{name} {way}: a summary once the client has left", 30,
                         lambda: len(bridge.said()) == len(figures))
    equal("drives (telemetries, human messages, bad frames)",
          [(s["telemetries"], s["human_messages"], s["bad_frames"]) for s in bridge.summaries],
          [(ROUNDS, ROUNDS, 0)] * len(figures))
    return "rtt p50: " + ", ".join(figures)
