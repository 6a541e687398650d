"""A WebSocket as the simulator opens it, for messages that unity_client.py never sends."""
import base64
import json
import os
import select
import socket
import struct
import time

from bridge import Failed, equal

TEXT, BINARY, CLOSE = 1, 2, 8


def frame(first, payload, mask=b"\1\2\3\4"):
    """A client's frame, masked; `first` is its first byte: the end of the message and the opcode."""
    n = len(payload)
    length = bytes([0x80 | n]) if n < 126 else struct.pack(">BH", 0xFE, n) if n < 1 << 16 else struct.pack(">BQ", 0xFF, n)
    pad = (mask * (n // 4 + 1))[:n]
    body = (int.from_bytes(payload, "big") ^ int.from_bytes(pad, "big")).to_bytes(n, "big") if n else b""
    return bytes([first]) + length + mask + body


def fragments(text, size=1016):
    """A text message in pieces, each a frame by itself; by default as websocket-sharp cuts it."""
    parts = [text[i:i + size] for i in range(0, len(text), size)]
    return [frame((i == 0) | (0x80 if i == len(parts) - 1 else 0), part, os.urandom(4)) for i, part in enumerate(parts)]


class Wire:
    """Dials, and sends and receives whole messages; `agent` is the User-Agent."""

    def __init__(self, port, agent="websocket-sharp/1.0"):
        self.buffer = b""
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=10)
        key = base64.b64encode(os.urandom(16)).decode()
        self.socket.sendall(
            f"GET /socket.io/?EIO=4&transport=websocket HTTP/1.1\r\nUser-Agent: {agent}\r\nUpgrade: websocket\r\n"
            f"Connection: Upgrade\r\nHost: 127.0.0.1:{port}\r\nSec-WebSocket-Key: {key}\r\n"
            f"Sec-WebSocket-Version: 13\r\n\r\n".encode())
        while b"\r\n\r\n" not in self.buffer:
            self.read()
        head, self.buffer = self.buffer.split(b"\r\n\r\n", 1)
        equal("answer to the WebSocket handshake", head[:12], b"HTTP/1.1 101")
        equal("WebSocket extensions offered", b"extensions" in head.lower(), False)

    def read(self):
        data = self.socket.recv(1 << 16)
        if not data:
            raise Failed("the connection: expected to stay open, got closed")
        self.buffer += data

    def send(self, data, opcode=TEXT):
        data = data.encode() if isinstance(data, str) else data
        self.socket.sendall(frame(0x80 | opcode, data, os.urandom(4)))

    def receive(self, seconds):
        """The next text message; None where none comes in time."""
        end = time.monotonic() + seconds
        while True:
            if (message := self.take()) is not None:
                return message
            if not select.select([self.socket], [], [], max(0, end - time.monotonic()))[0]:
                return None
            self.read()

    def take(self):
        b = self.buffer
        if len(b) < 2 or b[1] == 126 and len(b) < 4:
            return None
        n, at = (struct.unpack(">H", b[2:4])[0], 4) if b[1] == 126 else (b[1], 2)
        if n == 127 or len(b) < at + n:  # nothing that a bridge says is so long
            return None
        if b[0] == 0x80 | CLOSE:
            raise Failed(f"the connection: expected to stay open, got closed: {b[at + 2:at + n].decode()}")
        equal("a server's frame (whole text)", hex(b[0]), hex(0x80 | TEXT))
        self.buffer = b[at + n:]
        return b[at:at + n].decode()

    def answer(self, seconds=2.0):
        """The next event as (name, steering, throttle); anything else, or nothing in time, fails."""
        text = self.receive(seconds)
        if text is None or not text.startswith("42"):
            raise Failed(f"an answer within {seconds} s: expected 42[…], got {text!r}")
        name, payload = json.loads(text[2:])
        if name == "manual":
            return name, None, None
        equal("event", name, "steer")
        equal("kind of the fields", {k: type(v).__name__ for k, v in payload.items()},
              {"steering_angle": "str", "throttle": "str"})
        return name, float(payload["steering_angle"]), float(payload["throttle"])

    def close(self):
        self.socket.close()
