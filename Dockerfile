# docker build -t hydro_env . && docker run --rm -v "$PWD/results:/work/results" hydro_env study
FROM python:3.12-slim
WORKDIR /source
COPY . .
RUN pip install --no-cache-dir --constraint constraints.txt --extra-index-url https://download.pytorch.org/whl/cpu torch \
 && pip install --no-cache-dir --constraint constraints.txt ".[agents,export,recordings]"
WORKDIR /work
ENV NUMBA_CACHE_DIR=/tmp/numba
ENTRYPOINT ["hydro"]
CMD ["--help"]
