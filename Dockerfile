# SPDX-License-Identifier: Apache-2.0
# CPU only. docker build -t multilica . && docker run --rm -v "$PWD:/data" multilica calibrate drive.mcap
FROM python:3.12-slim
# The archive keeps no old versions that could be pinned.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libusb-1.0-0 libgl1 libegl1 libx11-6 libudev1 libidn2-0 libgomp1 \
    && rm -rf /var/lib/apt/lists/*
COPY . /src
RUN pip install --no-cache-dir --constraint /src/constraints.txt /src && rm -rf /src
RUN useradd --uid 1000 --create-home calibrator
USER 1000
WORKDIR /data
ENTRYPOINT ["multilica"]
