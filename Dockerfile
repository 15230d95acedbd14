# gffe-cl with PoCL, as a user without rights; results come into the folder out:
#     docker build -t gffe-cl . && mkdir -p out
#     docker run --rm -v "$PWD/out:/work/out" --user "$(id -u)" gffe-cl gffe demo
FROM python:3.12-slim-bookworm
RUN apt-get update && apt-get install -y --no-install-recommends pocl-opencl-icd && rm -rf /var/lib/apt/lists/*
COPY . /source
RUN pip install --no-cache-dir -c /source/constraints.txt '/source[lab,video]' && rm -rf /source
ENV GFFE_DEVICE=pocl HOME=/tmp
WORKDIR /work
USER nobody
CMD ["gffe", "demo"]
