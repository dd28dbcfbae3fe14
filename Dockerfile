# SPDX-License-Identifier: Apache-2.0
# CPU only, without Open3D. docker build -t multilica . && docker run --rm -v "$PWD:/data" multilica calibrate drive.mcap
FROM python:3.12-slim
COPY . /src
RUN pip install --no-cache-dir --constraint /src/constraints.txt '/src[fleet,las,live,remote]' && rm -rf /src
RUN useradd --uid 1000 --create-home calibrator
USER 1000
WORKDIR /data
ENTRYPOINT ["multilica"]
