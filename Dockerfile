# matcam and its dependencies, for Linux: `docker build -t matcam .`, then
# `docker run --rm -v "$PWD:/data" matcam correct chrome.binary -o corrected.binary`
FROM python:3.12-slim

COPY . /source
RUN pip install --no-cache-dir --constraint /source/.ci/constraints.txt "/source[raw,scale]" \
    && rm -rf /source \
    && useradd --create-home user

USER user
WORKDIR /data
ENTRYPOINT ["matcam"]
CMD ["--help"]
