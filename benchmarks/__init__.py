"""Speed, memory and quality of the methods: ``python -m benchmarks``. See README.md in this folder."""
