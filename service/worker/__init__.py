"""The worker process: it takes jobs off the queues and denoises them tile by tile."""
