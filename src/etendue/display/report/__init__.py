"""Pages of runs: pictures to explore and compare, errors, tables, and how to repeat them, in one HTML file."""

from .cards import card as card
from .comparison import render_report as render_report, write_report as write_report
from .entries import Entry as Entry
from .figures import Figure as Figure, fitted as fitted
from .machine import machine as machine
from .packing import Layer as Layer, shared_exponent as shared_exponent
from .pages import render_page as render_page
from .parts import (
    Command as Command,
    Facts as Facts,
    Failure as Failure,
    Figures as Figures,
    Folded as Folded,
    Measures as Measures,
    Page as Page,
    Part as Part,
    Plot as Plot,
    Scale as Scale,
    Section as Section,
    Text as Text,
)
from .pyramid import in_pyramid as in_pyramid, pyramids as pyramids
from .race import (
    Reached as Reached,
    equal_errors as equal_errors,
    equal_times as equal_times,
    error_at as error_at,
    over_seeds as over_seeds,
    time_to as time_to,
)
from .stacks import Stack as Stack, viewer_data as viewer_data
from .tables import (
    Column as Column,
    fact_table as fact_table,
    flatten as flatten,
    number_text as number_text,
    time_text as time_text,
    value_text as value_text,
)
