"""Formats of files: scenarios, and swarms as they were measured."""
