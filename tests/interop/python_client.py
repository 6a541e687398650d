"""An ordinary python-socketio client (4 or 5) that plays simulator, stop and go.

    python_client.py PORT polling|websocket|upgrade JPEG ROUNDS

Each round sends a telemetry and wants a `steer` whose fields are text that
reads as a number of -1 to 1, then sends null and wants `manual`. It prints one
JSON object and exits 1 at the first thing that is not so.
"""
import base64
import json
import os
import queue
import sys
import threading
import time
import traceback

import socketio

WAIT = 5.0  # seconds for an answer


def main(port, way, jpeg, rounds):
    client, answers = socketio.Client(reconnection=False), queue.Queue()
    client.on("steer", lambda payload: answers.put(("steer", payload)))
    client.on("manual", lambda payload: answers.put(("manual", payload)))
    ways = {} if way == "upgrade" else {"transports": [way]}  # by default it polls and upgrades
    client.connect(f"http://127.0.0.1:{port}", **ways)
    with open(jpeg, "rb") as file:
        image = base64.b64encode(file.read()).decode()
    telemetry = dict(steering_angle="0.0000", throttle="0.0000", speed="5.0000", image=image)
    times = []
    for _ in range(int(rounds)):
        began = time.perf_counter()
        client.emit("telemetry", telemetry)
        name, payload = answers.get(timeout=WAIT)
        times.append((time.perf_counter() - began) * 1e3)
        assert name == "steer", f"expected steer, got {name}"
        for field in ("steering_angle", "throttle"):
            value = payload[field]
            assert isinstance(value, str) and -1 <= float(value) <= 1, f"{field}: expected text of -1 to 1, got {value!r}"
        client.emit("telemetry", (None,))  # a tuple is the list of arguments, so this is null
        name, _ = answers.get(timeout=WAIT)
        assert name == "manual", f"expected manual, got {name}"
    print(json.dumps(dict(transport=client.transport(), rtt_p50_ms=round(sorted(times)[len(times) // 2], 2))), flush=True)
    # Both versions say goodbye at once, but now and then lose the packet that
    # would end their last poll, and then wait 25 s for it: that is not waited for.
    leaving = threading.Thread(target=client.disconnect, daemon=True)
    leaving.start()
    leaving.join(1)
    assert answers.empty(), f"expected no further answer, got {answers.get()}"
    os._exit(0)


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except BaseException:  # the client's own threads would keep the process
        traceback.print_exc()
        os._exit(1)
