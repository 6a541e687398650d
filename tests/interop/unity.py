"""The simulator's client with all its bad habits, for soaks: tokens counted one by one, pauses, ghosts, crashes.

A token is the right to send one telemetry. The client gets one as its WebSocket opens and one for each answer that
it takes; the program holds them, so they outlive a connection. Each game frame spends all that are held.
"""
import base64
import json
import os
import random
import re
import select
import socket
import struct
import time

from wire import fragments

COMMAND = re.compile(r'42\["(?:manual",\{\}|steer",\{"steering_angle":"-?\d+(?:e-?\d+)?","throttle":"-?\d+(?:e-?\d+)?".*\})\]')


class Gone(Exception):
    """The connection has ended; the simulator dials anew."""


class Connection:
    """A WebSocket as websocket-sharp has it: masked fragments with a write each, Nagle on."""

    def __init__(self, port):
        self.buffer, self.closed = b"", False
        try:
            self.socket = socket.create_connection(("127.0.0.1", port), timeout=10)
            key = base64.b64encode(os.urandom(16)).decode()
            self.socket.sendall(
                f"GET /socket.io/?EIO=4&transport=websocket HTTP/1.1\r\nUser-Agent: websocket-sharp/1.0\r\n"
                f"Upgrade: websocket\r\nConnection: Upgrade\r\nHost: 127.0.0.1:{port}\r\n"
                f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode())
            while b"\r\n\r\n" not in self.buffer:
                self.read()
        except OSError as why:
            raise Gone(f"{type(why).__name__} while dialling") from None
        head, self.buffer = self.buffer.split(b"\r\n\r\n", 1)
        if b" 101 " not in head.split(b"\r\n", 1)[0]:
            raise Gone(f"handshake answered {head.splitlines()[0].decode(errors='replace')!r}")
        self.pinged = time.monotonic()
        self.send("2")

    def read(self):
        data = self.socket.recv(1 << 16)
        if not data:
            raise Gone("closed")
        self.buffer += data

    def send(self, text):
        try:
            for part in fragments(text.encode()):
                self.socket.sendall(part)
        except OSError as why:
            raise Gone(f"{type(why).__name__} while sending") from None

    def messages(self, seconds):
        """What has come, waiting so long for the first; pings as the simulator does."""
        now = time.monotonic()
        if now - self.pinged > 25:
            self.pinged = now
            self.send("2")
        if self.closed:
            raise Gone("the bridge closed the WebSocket")
        found = list(self.whole())
        if not found and not self.closed and select.select([self.socket], [], [], seconds)[0]:
            try:
                self.read()
            except OSError as why:
                raise Gone(type(why).__name__) from None
            found = list(self.whole())
        return found

    def whole(self):
        while len(b := self.buffer) >= 2:
            n, at = (struct.unpack(">H", b[2:4])[0], 4) if b[1] == 126 and len(b) >= 4 else (b[1], 2)
            if n == 126 and at == 2 or len(b) < at + n:
                return
            self.buffer = b[at + n:]
            if b[0] == 0x88:
                self.closed = True
                return
            if b[0] == 0x81:
                yield b[at:at + n].decode()

    def reset(self):
        """As a killed process leaves it: a TCP reset, no goodbye."""
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.socket.close()


class Simulator:
    """Plays until it has sent so many telemetries, with whatever its seed brings on the way."""

    def __init__(self, port, seed, superset, jpegs, sent, quick):
        self.port, self.superset, self.sent, self.quick = port, superset, sent, quick
        self.random = random.Random(seed)
        self.images = [base64.b64encode(jpeg).decode() for jpeg in jpegs]
        self.connection, self.ghosts, self.tokens = None, [], 0
        self.acts = dict.fromkeys(("takeover", "pause", "freeze", "ghost", "kill", "quit", "late start"), 0)
        self.account = dict(telemetries=0, humans=0, answers=0, lost=[], surplus=[], checks=0, dials=0, swallowed=[])
        self.human_for, self.speed = 0, 0.0

    def play(self, target):
        self.dial()
        while self.account["telemetries"] < target:
            try:
                self.drive(self.random.randint(50, 1500))
                self.settle()
                act = self.random.choices(list(self.acts), (6, 4, 2, 2, 2, 1, 1))[0]
                getattr(self, act.replace(" ", "_"))()
                self.acts[act] += 1
            except Gone:
                self.dial()
        self.connection.send("41")
        self.connection.send("1")
        self.connection.socket.close()
        for ghost, _ in self.ghosts:
            ghost.socket.close()
        return dict(self.account, acts=self.acts, held=self.tokens)

    # -- what happens to a simulator ---------------------------------------

    def takeover(self):
        self.human_for = self.random.randint(1, 200)

    def pause(self):
        """The game stands still; its socket's thread reads, and pings."""
        self.idle(self.random.choice((0.3, 1.2, 2.5, 5.0)))

    def freeze(self):
        """The whole process stands still, now and then for longer than a bridge waits."""
        time.sleep(62.0 if self.random.random() < 0.15 and not self.quick else self.random.choice((0.3, 1.2, 2.5)))

    def ghost(self):
        """The scene is left with its socket open, and entered anew."""
        self.ghosts.append((self.connection, time.monotonic() + self.random.choice((1.0, 20.0, 70.0))))
        self.tokens = 0
        self.dial()

    def kill(self):
        self.connection.reset()
        self.tokens = 0
        self.dial()

    def quit(self):
        self.connection.send("41")
        self.connection.send("1")
        self.connection.socket.close()
        self.tokens = 0
        self.dial()

    def late_start(self):
        """The scene loads so slowly that the opening is missed: nothing is sent until it is kicked."""
        self.connection.reset()
        self.tokens = 0
        self.dial(opening=0)

    # -- the game -----------------------------------------------------------

    def dial(self, opening=1):
        """Dials until somebody answers, as the simulator does, if less hastily."""
        while True:
            try:
                self.connection = Connection(self.port)
                break
            except Gone:
                time.sleep(0.05)
        self.account["dials"] += 1
        self.tokens += opening

    def drive(self, telemetries):
        """Game frames until so many telemetries are sent; a frame spends every token there is."""
        end, last = self.account["telemetries"] + telemetries, time.monotonic()
        while self.account["telemetries"] < end:
            self.hear(0.05)
            if self.tokens:
                last = time.monotonic()
                for _ in range(self.tokens):
                    self.tell()
                self.tokens = 0
            elif time.monotonic() - last > 20:
                self.account["lost"].append(f"after {self.account['telemetries']} telemetries nothing came for 20 s")
                raise Gone("stalled")

    def settle(self):
        """Holds exactly one token once all answers are there?"""
        self.drive(40)
        end = time.monotonic() + 3
        while time.monotonic() < end and not self.tokens:
            self.hear(0.05)
        quiet = time.monotonic() + 0.15
        while time.monotonic() < quiet:
            self.hear(0.05)
        self.account["checks"] += 1
        if self.tokens != 1:
            kind = "surplus" if self.tokens else "lost"
            self.account[kind].append(f"{self.tokens} tokens after {self.account['telemetries']} telemetries, acts {self.acts}")
            # Not again at each check: what is wrong once stays wrong, and would be counted for ever.
            self.tokens = 1

    def idle(self, seconds):
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self.hear(min(left, 0.05))

    def hear(self, seconds):
        self.haunt()
        for message in self.connection.messages(seconds):
            if not message.startswith("42"):
                continue
            if COMMAND.fullmatch(message):
                self.account["answers"] += 1
                self.tokens += 1
            elif message.startswith(('42["steer', '42["manual')):
                self.account["swallowed"].append(message[:120])

    def haunt(self):
        """Ghosts answer pings and say nothing else, until they are dropped or their program ends."""
        for entry in list(self.ghosts):
            ghost, until = entry
            try:
                ghost.messages(0)
                if time.monotonic() < until:
                    continue
            except Gone:
                pass
            ghost.socket.close()
            self.ghosts.remove(entry)

    def tell(self):
        self.account["telemetries"] += 1
        with self.sent.get_lock():
            self.sent.value += 1
        if self.human_for:
            self.human_for -= 1
            self.account["humans"] += 1
            return self.connection.send('42["telemetry",null]')
        self.speed = min(30.0, self.speed + 0.01)
        fields = dict(steering_angle="0.0000", throttle="0.3000", speed=f"{self.speed:.4f}")
        if self.superset:
            fields.update(lapNumber="0", currentWayPoint="3", crash="0", tot_obes="0", tot_crashes="0", cte="0.1000")
        fields["image"] = self.images[self.account["telemetries"] % len(self.images)]
        self.connection.send('42["telemetry",%s]' % json.dumps(fields, separators=(",", ":")))
