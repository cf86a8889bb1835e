# Smalti in a container: API, queue, workers, or any of them (see docker-compose.yml).
#
#   docker build -t smalti .
#   docker run --rm -p 127.0.0.1:8000:8000 -v smalti-data:/data smalti
#
# The kernels are compiled here, once, for a processor that most machines can run (x86-64-v3: AVX2, since 2013). On others:
#   docker build --build-arg NUMBA_CPU_NAME=generic -t smalti .

ARG PYTHON_IMAGE=python:3.12-slim

# ---- build: what pip needs stays here -------------------------------------------------------------------------------
FROM ${PYTHON_IMAGE} AS build
WORKDIR /build
RUN python -m venv /opt/smalti
ENV PATH=/opt/smalti/bin:$PATH PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1

# The requirements alone first: they change seldom, so this layer is mostly kept.
COPY requirements.lock ./
RUN pip install --no-compile --require-hashes -r requirements.lock

COPY pyproject.toml README.md LICENSE ./
COPY tracer tracer
COPY worker worker
COPY service service
COPY client client
RUN pip install --no-compile --no-deps --no-build-isolation .

# Layers keep whole seconds of a file's time, and numba recompiles what seems newer or older than its cache: so all files
# get one whole second before anything is compiled. Bytecode is checked by nobody, for the same reason.
RUN find /opt/smalti -exec touch --no-dereference --date=@1700000000 {} + \
    && python -m compileall -q -j 0 --invalidation-mode unchecked-hash /opt/smalti/lib

# ---- final ----------------------------------------------------------------------------------------------------------
FROM ${PYTHON_IMAGE} AS final
ARG NUMBA_CPU_NAME=x86-64-v3
# In a container the API listens on every address, where it would answer to every name: yet it is meant for loopback, and
# a page elsewhere must not reach it by a name that suddenly means 127.0.0.1. To serve others: SMALTI_ALLOWED_HOSTS=name.
ENV PATH=/opt/smalti/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    NUMBA_CPU_NAME=${NUMBA_CPU_NAME} \
    NUMBA_CPU_FEATURES="" \
    SMALTI_CACHE=/var/cache/smalti \
    SMALTI_STORE=/data \
    SMALTI_ALLOWED_HOSTS=localhost \
    SMALTI_READY_FILE=/tmp/smalti-ready.json

RUN useradd --system --uid 10001 --user-group --home-dir /var/lib/smalti --create-home smalti \
    && install --directory --owner smalti --group smalti /data /var/cache/smalti
COPY --from=build /opt/smalti /opt/smalti
WORKDIR /var/lib/smalti
USER smalti

# By the user who uses them. Processes map an image that is known by its content alone; numba's cache, beside it, also
# by place and time.
RUN smalti warm

VOLUME /data
EXPOSE 8000
STOPSIGNAL SIGTERM
# The farm writes this file once all its parts answer, and removes it at the end; workers without an API have it, too.
HEALTHCHECK --interval=10s --timeout=5s --start-period=60s --retries=3 CMD ["test", "-s", "/tmp/smalti-ready.json"]
ENTRYPOINT ["smalti"]
CMD ["serve", "--host", "0.0.0.0", "--port", "8000"]
