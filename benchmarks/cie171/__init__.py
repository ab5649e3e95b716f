"""CIE 171:2006, test cases 5.2 to 5.14: analytic tests of programs for lighting, against closed forms and integrals.

``rooms``: geometry; ``references``: what is true, by NumPy alone; ``cases``: scenes, meters and references;
``patches``: the cases of diffuse reflection by radiosity; ``suite``: the command.
"""
