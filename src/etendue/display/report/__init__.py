"""Pages of runs: pictures to explore and compare, errors, tables, and how to repeat them, in one HTML file."""

from .cards import card
from .comparison import render_report, write_report
from .entries import Entry
from .figures import Figure, fitted
from .machine import machine
from .packing import Layer, shared_exponent
from .pages import render_page
from .parts import Command, Facts, Failure, Figures, Folded, Measures, Page, Part, Plot, Scale, Section, Text
from .pyramid import in_pyramid, pyramids
from .race import Reached, equal_errors, equal_times, error_at, over_seeds, time_to
from .stacks import Stack, viewer_data
from .tables import Column, fact_table, flatten, number_text, time_text, value_text

__all__ = [
    "Column",
    "Command",
    "Entry",
    "Facts",
    "Failure",
    "Figure",
    "Figures",
    "Folded",
    "Layer",
    "Measures",
    "Page",
    "Part",
    "Plot",
    "Reached",
    "Scale",
    "Section",
    "Stack",
    "Text",
    "card",
    "equal_errors",
    "equal_times",
    "error_at",
    "fact_table",
    "fitted",
    "flatten",
    "in_pyramid",
    "machine",
    "number_text",
    "over_seeds",
    "pyramids",
    "render_page",
    "render_report",
    "shared_exponent",
    "time_text",
    "time_to",
    "value_text",
    "viewer_data",
    "write_report",
]
