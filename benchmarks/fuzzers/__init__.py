"""The parts of benchmarks/fuzz_codecs.py: what each codec is fed with, and what it must never do."""

from .fuzzer import Fuzzer, FuzzResult, all_fuzzers, run_fuzzer

__all__ = ["FuzzResult", "Fuzzer", "all_fuzzers", "run_fuzzer"]
