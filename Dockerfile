# GN0 on a CPU:  docker build -t gn0 .  &&  docker run --rm -v "$PWD/out:/home/gn0/out" gn0 demo --out out/demo
FROM python:3.12-slim AS build
WORKDIR /src
COPY pyproject.toml README.md LICENSE ./
COPY src ./src
COPY release ./release
RUN pip install --no-cache-dir build && python -m build --wheel --outdir /wheels

FROM python:3.12-slim
COPY --from=build /wheels /wheels
# the viewer: docker run -p 127.0.0.1:8080:8080 -v "$PWD/out:/home/gn0/out" gn0 view out/flat --host 0.0.0.0 --allow-remote
RUN pip install --no-cache-dir "$(ls /wheels/*.whl)[view]" && rm -r /wheels && useradd --create-home gn0
USER gn0
WORKDIR /home/gn0
ENV GN0_CACHE=/home/gn0/.cache/gn0
# proves the image, and compiles the kernels while it is made, not when it is first used
RUN gn0 doctor --compile && gn0 demo --out /tmp/demo && rm -r /tmp/demo
ENTRYPOINT ["gn0"]
CMD ["--help"]
