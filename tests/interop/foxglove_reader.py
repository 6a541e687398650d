"""Reads a drive as Foxglove's own packages do and prints one JSON object: of a run's file, or of a live drive.

    foxglove_reader.py FILE
    foxglove_reader.py ws://HOST:PORT/ PROTOCOL     all channels, until the server hangs up

Each protobuf message is decoded twice: by the schema that comes with it, and by the class that Foxglove publishes under
its name. It exits 1 where the two differ.
"""
import asyncio
import base64
import importlib
import json
import sys
from collections import Counter

import websockets
from mcap.reader import make_reader
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory


class Reader:
    """What was seen on all channels."""

    def __init__(self):
        self.counts, self.lines, self.roads, self.entities = Counter(), [], [], set()
        self.directions, self.late, self.decoders = Counter(), 0, {}
        self.last = {}

    def message(self, topic, schema, time_ns, data):
        self.counts[topic] += 1
        self.late += time_ns < self.last.get(topic, 0)
        self.last[topic] = time_ns
        if schema.encoding == "jsonschema":
            json.loads(data)
            return
        if schema.name not in self.decoders:
            package, name = schema.name.split(".")
            published = getattr(importlib.import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)
            self.decoders[schema.name] = DecoderFactory().decoder_for("protobuf", schema), published
        told, published = self.decoders[schema.name]
        message = published.FromString(data)
        by_its_schema = told(data).SerializeToString(deterministic=True)
        assert by_its_schema == message.SerializeToString(deterministic=True), f"{topic}: not a {schema.name}"
        assert len(data) == message.ByteSize(), f"{topic}: fields that {schema.name} does not have"
        getattr(self, schema.name.split(".")[1])(message, time_ns)

    def CompressedImage(self, image, time_ns):
        assert image.format == "jpeg" and image.data[:2] == b"\xff\xd8" and image.data[-2:] == b"\xff\xd9"
        assert image.timestamp.ToNanoseconds() == time_ns, (image.timestamp, time_ns)

    def Log(self, line, time_ns):
        self.lines.append([line.level, line.message])

    def FrameTransform(self, moved, time_ns):
        q = moved.rotation
        assert abs(q.x**2 + q.y**2 + q.z**2 + q.w**2 - 1) < 1e-9, q
        assert (moved.parent_frame_id, moved.child_frame_id) == ("world", "car"), moved
        ahead = 1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y + q.w * q.z)
        there = moved.translation
        if "tf" in self.last and (way := (there.x - self.last["tf"][0], there.y - self.last["tf"][1])) and abs(way[0]) + abs(way[1]) > 0.3:
            self.directions["ahead" if way[0] * ahead[0] + way[1] * ahead[1] > 0 else "astern"] += 1
        self.last["tf"] = there.x, there.y
        # The car is on the road that is drawn.
        if self.roads:
            self.last["off"] = min(abs(x - there.x) + abs(y - there.y) + abs(z - there.z) for x, y, z in self.roads[-1])

    def SceneUpdate(self, scene, time_ns):
        for entity in scene.entities:
            self.entities.add((entity.id, entity.frame_id))
            for surface in entity.triangles:
                assert max(surface.indices) < len(surface.points) and len(surface.indices) % 3 == 0
                self.roads.append([(p.x, p.y, p.z) for p in surface.points])

    def found(self):
        return dict(counts=self.counts, lines=self.lines, entities=sorted(self.entities), late=self.late,
                    road_points=[len(road) for road in self.roads], directions=self.directions, off_m=self.last.get("off"))


def read_file(path):
    reader = Reader()
    with open(path, "rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            reader.message(channel.topic, schema, message.log_time, message.data)
    return reader.found()


async def read_live(address, protocol):
    reader, channels = Reader(), {}
    async with websockets.connect(address, subprotocols=[protocol], max_size=None) as socket:
        assert socket.subprotocol == protocol, socket.subprotocol
        info = json.loads(await socket.recv())
        assert info["op"] == "serverInfo" and info["capabilities"] == [], info
        async for message in socket:
            if isinstance(message, str):
                said = json.loads(message)
                assert said["op"] == "advertise", said
                for channel in said["channels"]:
                    is_binary = channel["schemaEncoding"] == "protobuf"
                    data = base64.b64decode(channel["schema"]) if is_binary else channel["schema"].encode()
                    schema = Schema(id=channel["id"] + 1, name=channel["schemaName"], encoding=channel["schemaEncoding"], data=data)
                    channels[channel["id"]] = channel["topic"], schema
                wanted = [dict(id=channel["id"], channelId=channel["id"]) for channel in said["channels"]]
                await socket.send(json.dumps(dict(op="subscribe", subscriptions=wanted)))
            else:
                assert message[0] == 1, message[0]
                topic, schema = channels[int.from_bytes(message[1:5], "little")]
                reader.message(topic, schema, int.from_bytes(message[5:13], "little"), message[13:])
    return reader.found()


if __name__ == "__main__":
    arguments = sys.argv[1:]
    print(json.dumps(read_file(*arguments) if len(arguments) == 1 else asyncio.run(read_live(*arguments))))
