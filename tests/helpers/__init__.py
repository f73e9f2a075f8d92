"""What tests share, imported as ``from helpers.x import y``; no test imports another test."""
