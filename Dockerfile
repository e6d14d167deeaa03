# syntax=docker/dockerfile:1
# The bases are arguments, so that mirrors and other distributions can stand in; deploy/README.md builds them from Debian's
# packages alone.
ARG BUILD_IMAGE=docker.io/library/rust:1.95-bookworm
ARG RUNTIME_IMAGE=docker.io/library/debian:bookworm-slim

FROM ${BUILD_IMAGE} AS build
WORKDIR /src
COPY deploy/setup.sh deploy/setup.sh
RUN deploy/setup.sh
COPY . .
# One unit takes longer to compile, and what comes of it is a twentieth quicker to its first plans.
RUN CARGO_PROFILE_RELEASE_CODEGEN_UNITS=1 cargo build --release --locked && cp target/release/quadrille /quadrille
# An empty folder that belongs to the user below: what a volume is filled with at first.
RUN mkdir /data && chown 65532:65532 /data

FROM ${RUNTIME_IMAGE}
COPY --from=build /quadrille /usr/local/bin/quadrille
COPY --from=build --chown=65532:65532 /data /data
# A number, so that nothing has to be created and Kubernetes can check that it is not root.
USER 65532:65532
# Jobs and workcells are in the volume, so that they survive the process.
ENV QUADRILLE_LISTEN=0.0.0.0:8080 \
    QUADRILLE_DATA_DIR=/data \
    QUADRILLE_LOG_FORMAT=json
EXPOSE 8080
VOLUME /data
HEALTHCHECK --interval=10s --timeout=5s --start-period=5s --retries=3 CMD ["quadrille", "health"]
ENTRYPOINT ["quadrille"]
CMD ["serve"]
