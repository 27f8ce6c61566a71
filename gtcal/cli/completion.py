"""gtcal completion: what makes a shell complete gtcal's commands, options and choices."""

from __future__ import annotations

from typing import Annotated, Literal

import tyro


def completion(shell: Annotated[tyro.conf.Positional[Literal["bash", "zsh", "fish"]], tyro.conf.arg()]) -> None:
    """Print the script that makes a shell complete gtcal's commands, options, choices and files.

    Put it where the shell looks for such scripts, and open a new shell:

        gtcal completion bash > ~/.local/share/bash-completion/completions/gtcal

        gtcal completion zsh > ~/.zfunc/_gtcal   (with 'fpath+=~/.zfunc' before 'compinit' in ~/.zshrc)

        gtcal completion fish > ~/.config/fish/completions/gtcal.fish

    Or for this shell alone: 'source <(gtcal completion bash)'.

    Args:
        shell: The shell.
    """
    from contextlib import redirect_stdout, suppress
    from importlib import import_module
    from io import StringIO

    from gtcal.cli import COMMANDS

    functions = {name: getattr(import_module(f"gtcal.cli.{name}"), name) for name in COMMANDS}
    script = StringIO()
    with suppress(SystemExit), redirect_stdout(script):  # which is how tyro ends once it has printed
        tyro.extras.subcommand_cli_from_dict(functions, prog="gtcal", args=["--tyro-write-completion", shell, "-"])
    print("\n".join(map(_mended, script.getvalue().splitlines())))


def _mended(line: str) -> str:
    """A line of tyro's script, which would offer every line of a description as a completion, and no files where a
    command takes them without an option."""
    if line.startswith("COMPLETION_SPEC = "):
        return line.replace("\\n", " ").replace("%%", "%")
    files = "completions or ['__TYRO_COMPLETE_FILES__']"
    return line.replace("for completion in completions:", f"for completion in {files}:")
