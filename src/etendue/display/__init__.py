"""Display: denoising, tone curves, false colours, PNG, tev, convergence plots, projections of points, pages of runs."""

from typing import TYPE_CHECKING

from etendue.core import on_use

if TYPE_CHECKING:
    from .colours import false_colour as false_colour
    from .curves import CURVES as CURVES, ToneCurve as ToneCurve
    from .denoising import (
        DENOISERS as DENOISERS,
        Denoiser as Denoiser,
        Filter as Filter,
        denoiser as denoiser,
        parse_filters as parse_filters,
        part_names as part_names,
    )
    from .developing import develop as develop
    from .legends import (
        check_range as check_range,
        false_colour_picture as false_colour_picture,
        luminance_picture as luminance_picture,
    )
    from .meshes import MeshView as MeshView, mesh_picture as mesh_picture
    from .pages import page as page
    from .plots import Series as Series, convergence_plot as convergence_plot
    from .png import encode_png as encode_png, write_png as write_png
    from .report import (
        Column as Column,
        Command as Command,
        Entry as Entry,
        Facts as Facts,
        Failure as Failure,
        Figure as Figure,
        Figures as Figures,
        Folded as Folded,
        Layer as Layer,
        Measures as Measures,
        Page as Page,
        Part as Part,
        Plot as Plot,
        Scale as Scale,
        Section as Section,
        Stack as Stack,
        Text as Text,
        card as card,
        fact_table as fact_table,
        fitted as fitted,
        flatten as flatten,
        in_pyramid as in_pyramid,
        machine as machine,
        number_text as number_text,
        over_seeds as over_seeds,
        pyramids as pyramids,
        render_page as render_page,
        render_report as render_report,
        time_text as time_text,
        value_text as value_text,
        viewer_data as viewer_data,
        write_report as write_report,
    )
    from .scatter import Projection as Projection, projection_plot as projection_plot
    from .tev import TevDisplay as TevDisplay
    from .tonemapping import auto_exposure as auto_exposure, check_tone as check_tone, tonemap as tonemap
else:
    __getattr__, __dir__ = on_use(__name__)
