"""Errors of a solution against a truth or against fixes."""
