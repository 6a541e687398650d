"""Reads a run with the stock packages `mcap` and `mcap-protobuf-support` and prints one JSON object.

    read_run.py FILE                     all of it, by its index
    read_run.py FILE --cut-off           as a stream, up to where it breaks off
    read_run.py FILE --first-frame OUT   writes the first camera frame to OUT

It exits 1 where a message is not what its schema says.
"""
import hashlib
import json
import sys
from collections import Counter

from mcap.reader import NonSeekingReader, make_reader
from mcap_protobuf.decoder import DecoderFactory


def main(path, mode=None, out=None):
    counts, frames, keys = Counter(), [], {}
    with open(path, "rb") as file:
        whole = mode != "--cut-off"
        reader = (make_reader if whole else NonSeekingReader)(file, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary() if whole else None
        metadata = {m.name: m.metadata for m in reader.iter_metadata()} if whole else {}
        try:
            for schema, channel, message in reader.iter_messages(log_time_order=whole):
                counts[channel.topic] += 1
                if channel.message_encoding == "json":
                    keys.setdefault(channel.topic, set()).update(json.loads(message.data))
                elif schema.name == "foxglove.CompressedImage":
                    image = DecoderFactory().decoder_for("protobuf", schema)(message.data)
                    assert image.format == "jpeg", f"format: expected 'jpeg', got {image.format!r}"
                    data = bytes(image.data)
                    assert data[:2] == b"\xff\xd8" and data[-2:] == b"\xff\xd9", f"no whole JPEG: {data[:4]}…{data[-4:]}"
                    frames.append(hashlib.sha256(data).hexdigest())
                    if mode == "--first-frame":
                        with open(out, "wb") as jpeg:
                            jpeg.write(data)
                        break
            ended = "whole"
        except Exception as error:  # whatever a cut-off file makes of the stock reader
            if whole:
                raise
            ended = f"{type(error).__name__}: {error}"
    print(json.dumps(dict(
        counts=counts, frames=frames, ended=ended, metadata=metadata,
        keys={topic: sorted(names) for topic, names in keys.items()},
        in_footer=summary.statistics.message_count if summary and summary.statistics else None,
    )))


if __name__ == "__main__":
    main(*sys.argv[1:])
