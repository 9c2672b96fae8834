# The demo, the environments and LeRobot's commands, on the CPU. Clouds and pictures need no Vulkan device.
#   docker build -t adamanip .
#   docker run --rm -v "$PWD/outputs:/adamanip/outputs" adamanip
#   docker run --rm -v "$PWD/outputs:/adamanip/outputs" adamanip lerobot-eval --policy.path=... --env.type=adamanip_safe
FROM python:3.12-slim-bookworm
RUN apt-get update && apt-get install -y --no-install-recommends make && rm -rf /var/lib/apt/lists/*
WORKDIR /adamanip
COPY . .
RUN PIP_NO_CACHE_DIR=1 make setup && rm -rf /var/lib/apt/lists/*
ENV PATH=/adamanip/.venv/bin:$PATH
CMD ["make", "demo"]
