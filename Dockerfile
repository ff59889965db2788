# docker build -t palpate . && docker run --rm -v "$PWD/sessions:/palpate/sessions" palpate
# Runs `palpate demo`; give another command behind the name: docker run --rm palpate palpate --help
FROM python:3.11-slim
# Pinocchio's wheel takes OpenMP from the system.
RUN apt-get update && apt-get install -y --no-install-recommends libgomp1 && rm -rf /var/lib/apt/lists/*
WORKDIR /palpate
COPY . .
RUN pip install --no-cache-dir --only-binary=:all: -c constraints.txt '.[sim]'
CMD ["palpate", "demo"]
