"""A bridge of the kind that people have: python-socketio 4 on eventlet, as drive.py runs it.

    drive_py.py PORT

Greets with a `steer` of its own, as drive.py does, steers by the ground truth of the telemetry and
prints a line of JSON for each telemetry. Ends when it is stopped.
"""
import json
import sys

import eventlet
import eventlet.wsgi
import socketio

sio = socketio.Server(async_mode="eventlet")


def send(steering, throttle):
    sio.emit("steer", data={"steering_angle": str(steering), "throttle": str(throttle)}, skip_sid=True)


@sio.on("connect")
def connect(sid, environ):
    send(0, 0)


@sio.on("telemetry")
def telemetry(sid, data):
    if not data:
        sio.emit("manual", data={}, skip_sid=True)
        return
    told = {key: value for key, value in data.items() if key != "image"}
    print(json.dumps(dict(told, image=len(data["image"]))), flush=True)
    # Back to the line, and along it.
    steering = -0.1 * float(data["cte"]) - 0.04 * float(data["ang_diff"]) if "cte" in data else 0.0
    send(round(max(-1.0, min(1.0, steering)), 4), 0.3 if float(data["speed"]) < 15 else 0.0)


eventlet.wsgi.server(eventlet.listen(("127.0.0.1", int(sys.argv[1]))), socketio.Middleware(sio), log_output=False)
