# The monitor on a small image, as a user without rights: docker build -t o2-monitor .
# Both stages run on amd64 and arm64: docker buildx build --platform linux/amd64,linux/arm64 .
FROM python:3.12-slim AS build
WORKDIR /source
COPY . .
RUN python -m venv /opt/o2mon \
 && /opt/o2mon/bin/pip install --no-cache-dir --disable-pip-version-check \
      -c constraints.txt '.[diagnostics,mqtt]'

FROM python:3.12-slim
LABEL org.opencontainers.image.title="o2-monitor" \
      org.opencontainers.image.licenses="Apache-2.0"
COPY --from=build /opt/o2mon /opt/o2mon
ENV PATH=/opt/o2mon/bin:$PATH \
    PYTHONDONTWRITEBYTECODE=1
RUN useradd --create-home --uid 1000 o2mon
USER o2mon
WORKDIR /home/o2mon
ENTRYPOINT ["o2mon"]
CMD ["--help"]
