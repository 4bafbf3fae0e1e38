"""The studies that write the measurement reports of docs/, a folder each."""
