# SPDX-License-Identifier: Apache-2.0
# CPU only. docker build -t multilica . && docker run --rm -v "$PWD:/data" multilica calibrate drive.mcap
FROM python:3.12.11-slim-bookworm
# Debian's libraries of a release stay compatible, so they have no versions here.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends \
        libegl1 libgl1 libgomp1 libidn2-0 libudev1 libusb-1.0-0 libx11-6 \
    && rm -rf /var/lib/apt/lists/*
RUN --mount=type=bind,target=/src,rw pip install --no-cache-dir --constraint /src/constraints.txt '/src[fleet,las,live,remote]'
RUN useradd --uid 1000 --create-home calibrator
USER 1000
WORKDIR /data
ENTRYPOINT ["multilica"]
