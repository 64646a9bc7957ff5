# The two commands of the README: the image holds the demo and its report, and running it runs the tests.
FROM python:3.11-bookworm
RUN apt-get update && apt-get install -y --no-install-recommends libegl1 libgl1 libgomp1 libudev1 libx11-6 make \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /turtlebag
COPY . .
RUN make demo
CMD ["make", "test"]
