# Not built here: the machine on which this was written has no Docker. What it relies on is tested: `scripts/dist.py --try`
# unpacks the same archive into a root with libc alone, and drives there.
#
#   docker build -t lapwing .
#   docker run --rm -p 4567:4567 lapwing                     the bridge; anybody who reaches the port may drive: docs/explanation/security.md
#   docker run --rm -v "$PWD:/work" lapwing drive --track lake
FROM rust:1.95-bookworm AS build
RUN apt-get update && apt-get install -y --no-install-recommends python3 python3-pip && rm -rf /var/lib/apt/lists/*
WORKDIR /lapwing
COPY . .
RUN make build && python3 scripts/dist.py && mkdir /opt/lapwing && tar -xzf target/dist/*.tar.gz -C /opt/lapwing --strip-components 1

FROM debian:bookworm-slim
COPY --from=build /opt/lapwing /opt/lapwing
RUN ln -s /opt/lapwing/lapwing /usr/local/bin/lapwing && useradd --create-home driver && mkdir /work && chown driver /work
USER driver
WORKDIR /work
EXPOSE 4567
ENTRYPOINT ["lapwing"]
CMD ["serve", "--bind", "0.0.0.0"]
