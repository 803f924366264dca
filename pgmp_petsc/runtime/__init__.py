"""Services that every layer may use: errors, agreement between ranks, files, timings, progress."""
