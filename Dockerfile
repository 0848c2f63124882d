# docker build -t bench . && docker run --rm -v "$PWD:/work" bench run figure-eight
# For filters of strangers: add --network none. Not yet run.
FROM python:3.14-slim
WORKDIR /src
COPY requirements-core.lock .
RUN pip install --no-cache-dir --disable-pip-version-check --require-hashes --requirement requirements-core.lock
COPY . .
# hatchling, which builds the package, is not locked here; it is gone with its build
RUN pip install --no-cache-dir --disable-pip-version-check --no-deps . && rm -rf /src
RUN useradd --create-home bench && mkdir /work && chown bench /work
USER bench
WORKDIR /work
# the compiled kernels are a part of the image
RUN bench warm
ENTRYPOINT ["bench"]
