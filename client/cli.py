"""The command line `smalti`.

Invariants: every failure ends in one of the documented exit codes with a message that says what to do, never in a
traceback (`SMALTI_TRACEBACK=1` shows it); `smalti --help` imports neither httpx nor anything that renders.
"""

import os
import signal
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from client import commands_jobs, commands_local
from client.errors import EXIT_CODE_MEANINGS, ExitCode, SmaltiError
from client.terminal import Terminal, clean

RENDER = "Render"
JOBS = "Jobs of a service"
RUN = "Run a service"


class _Group(TyperGroup):
    """The commands in panels, with all errors turned into messages and exit codes."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands by what they are for."""
        panels: dict[str, list[tuple[str, str]]] = {}
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if command is not None and not command.hidden:
                rows = panels.setdefault(getattr(command, "rich_help_panel", None) or "Commands", [])
                rows.append((name, command.get_short_help_str(limit=120)))
        for title, rows in panels.items():
            with formatter.section(title):
                formatter.write_dl(rows)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the table of exit codes."""
        del ctx
        with formatter.section("Exit codes"):
            formatter.write_dl([(f"{int(code)}", text) for code, text in EXIT_CODE_MEANINGS.items()])

    def invoke(self, ctx: Any) -> Any:
        as_json = "--json" in sys.argv[1:] or "--json" in (getattr(ctx, "protected_args", None) or [])
        as_json = as_json or "--json" in ctx.args
        try:
            return super().invoke(ctx)
        except SmaltiError as error:
            _reraise_if_asked()
            Terminal(as_json=as_json).error(error)
            raise typer.Exit(int(error.exit_code)) from None
        except KeyboardInterrupt:
            # From here on nothing is left to interrupt. Python's own end puts the default handler back, which would
            # turn a second Ctrl-C into a death by signal; an ignored signal it leaves ignored.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            _reraise_if_asked()
            Terminal().warn("interrupted")
            raise typer.Exit(int(ExitCode.INTERRUPTED)) from None
        except BrokenPipeError:
            # The reader of our output went away (`smalti list | head`): nothing to say, and nobody to say it to.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(int(ExitCode.OK)) from None
        except OSError as error:
            _reraise_if_asked()
            place = f": {error.filename}" if error.filename else ""
            Terminal(as_json=as_json).error(SmaltiError(f"{error.strerror or error}{place}"))
            raise typer.Exit(int(ExitCode.UNEXPECTED)) from None
        except Exception as error:
            # Click's own exceptions carry an exit code and print themselves.
            if hasattr(error, "exit_code"):
                raise
            _reraise_if_asked()
            text = f"unexpected {type(error).__name__}: {clean(str(error))}"
            hint = "this is a fault of Smalti; SMALTI_TRACEBACK=1 shows where it happened"
            Terminal(as_json=as_json).error(SmaltiError(text, hint=hint))
            raise typer.Exit(int(ExitCode.UNEXPECTED)) from None


def _reraise_if_asked() -> None:
    if os.environ.get("SMALTI_TRACEBACK"):
        raise  # noqa: PLE0704 - called inside an except block


app = typer.Typer(
    name="smalti",
    cls=_Group,
    help="Smalti renders scenes by ray tracing: here (`render`), or as jobs of a service (`submit`).",
    no_args_is_help=True,
    rich_markup_mode=None,  # importing rich doubles the time of --help (0.29 s of CPU to 0.67 s)
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(value: bool) -> None:
    if value:
        from importlib.metadata import version

        Terminal().out(f"smalti {version('smalti')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    del version


for _name, _function, _panel in (
    ("render", commands_local.render, RENDER),
    ("validate", commands_jobs.validate, RENDER),
    ("schema", commands_jobs.schema, RENDER),
    ("submit", commands_jobs.submit, JOBS),
    ("status", commands_jobs.status, JOBS),
    ("watch", commands_jobs.watch, JOBS),
    ("get", commands_jobs.get, JOBS),
    ("cancel", commands_jobs.cancel, JOBS),
    ("delete", commands_jobs.delete, JOBS),
    ("list", commands_jobs.list_jobs, JOBS),
    ("serve", commands_local.serve, RUN),
    ("worker", commands_local.worker, RUN),
    ("warm", commands_local.warm, RUN),
    ("doctor", commands_local.doctor, RUN),
    ("demo", commands_local.demo, RUN),
):
    app.command(_name, rich_help_panel=_panel)(_function)


def main() -> None:
    """Run the command line."""
    try:
        app(prog_name="smalti")
    except KeyboardInterrupt:  # before or after a command
        sys.exit(int(ExitCode.INTERRUPTED))
