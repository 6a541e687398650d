"""Holds each JSON message of runs against the schema in the same file, with the stock packages `mcap` and `jsonschema`.

    check_schemas.py FILE ...     prints one JSON object: messages by topic, events by kind

It exits 1 where a schema is none, or a message is not what its schema says.
"""
import json
import sys
from collections import Counter

from jsonschema import Draft202012Validator
from mcap.reader import make_reader


def main(*paths):
    counts, kinds = Counter(), Counter()
    for path in paths:
        validators = {}
        with open(path, "rb") as file:
            for schema, channel, message in make_reader(file).iter_messages():
                if channel.message_encoding != "json":
                    continue
                if schema.id not in validators:
                    said = json.loads(schema.data)
                    Draft202012Validator.check_schema(said)
                    validators[schema.id] = Draft202012Validator(said)
                told = json.loads(message.data)
                wrong = [error.message for error in validators[schema.id].iter_errors(told)]
                assert not wrong, f"{path}: {channel.topic}: {told}: {wrong}"
                counts[channel.topic] += 1
                if channel.topic == "/event":
                    kinds[told["kind"]] += 1
        assert len(validators) == 3, f"{path}: expected the schemas of 3 topics, got {len(validators)}"
    # What they must not take: a lap without its time, an event that there is not, a speed of a million.
    lap, speed = {"kind": "lap", "number": 1, "time_s": 60.0}, {"steering_deg": 1.0, "throttle": 0.2, "speed_mph": 30.0}
    samples = {"/event": (lap, [{"kind": "lap", "number": 1}, {"kind": "landed"}]),
               "/telemetry": (speed, [{**speed, "speed_mph": 1e6}])}
    with open(paths[0], "rb") as file:
        summary = make_reader(file).get_summary()
    for channel in summary.channels.values():
        if channel.topic in samples:
            validator = Draft202012Validator(json.loads(summary.schemas[channel.schema_id].data))
            good, bad = samples[channel.topic]
            assert validator.is_valid(good), f"{channel.topic}: expected {good} to be taken"
            for one in bad:
                assert not validator.is_valid(one), f"{channel.topic}: expected {one} to be refused"
    print(json.dumps(dict(counts=counts, kinds=kinds)))


if __name__ == "__main__":
    main(*sys.argv[1:])
