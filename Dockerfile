# gffe-cl with PoCL, as a user without rights:
#     docker build -t gffe-cl . && docker run --rm -v "$PWD/out:/out" --user "$(id -u)" gffe-cl gffe demo
FROM python:3.12-slim-bookworm
RUN apt-get update && apt-get install -y --no-install-recommends pocl-opencl-icd && rm -rf /var/lib/apt/lists/*
COPY . /source
RUN pip install --no-cache-dir -c /source/constraints.txt '/source[lab,video]' && rm -rf /source
ENV GFFE_DEVICE=pocl HOME=/tmp
WORKDIR /out
RUN chmod 1777 /out
USER nobody
CMD ["gffe", "demo", "--output", "/out/demo"]
