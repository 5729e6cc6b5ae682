# docker build -t hydro_env . && docker run --rm -v "$PWD/results:/work/results" hydro_env study
FROM python:3.12-slim
# hydro export plant compiles the binary of the FMU.
RUN apt-get update && apt-get install -y --no-install-recommends gcc libc6-dev && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY . .
RUN pip install --no-cache-dir --constraint constraints.txt --extra-index-url https://download.pytorch.org/whl/cpu torch \
 && pip install --no-cache-dir --constraint constraints.txt ".[agents,export,recordings]"
WORKDIR /work
ENV NUMBA_CACHE_DIR=/opt/numba
# Machine code for this processor: without it every container compiles anew. Any user may add to it.
RUN python /source/benchmarks/compile_all.py && chmod -R a+rwX /opt/numba
ENTRYPOINT ["hydro"]
CMD ["--help"]
