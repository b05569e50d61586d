"""What the operating system gives: files written whole, streams and exit codes, threads, compiled loops."""
