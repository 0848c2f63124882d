"""The requirement by which another machine installs this bench: a released version, a commit, or a wheel."""

from __future__ import annotations

import json
import subprocess
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

NAME = "ins-gnss-bench"
_HASHES = ("sha256", "sha512")


def find_requirement(folder: Path = Path()) -> tuple[str, str]:
    """Return the requirement for pip, and a remark if it is incomplete; each may be empty.

    It is read from what pip has noted of the installation (PEP 610). A commit counts if it lies in a
    repository with a remote; a wheel on this machine counts if it lies in ``folder``, that of the repository.
    """
    try:
        package = distribution(NAME)
        noted: dict[str, Any] = json.loads(package.read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError):
        return NAME, "bench is not installed here: name the version"
    released = f"{NAME}=={package.version}"
    if "url" not in noted:
        return released, ""
    url = str(noted["url"])
    if commit := noted.get("vcs_info", {}).get("commit_id"):
        return f"{NAME} @ {noted['vcs_info']['vcs']}+{url}@{commit}", ""
    if urlsplit(url).scheme != "file":
        hashes = noted.get("archive_info", {}).get("hashes") or {}
        name = next((name for name in _HASHES if name in hashes), "")
        return f"{NAME} @ {url}{f'#{name}={hashes[name]}' if name else ''}", ""
    path = Path(unquote(urlsplit(url).path))
    if path.is_dir():
        found = _find_commit(path)
        if found:
            return f"{NAME} @ git+{found}", ""
        return (
            released,
            f"bench is installed from {path.name}/, which has no remote: is {released} published?",
        )
    if path.resolve().is_relative_to(folder.resolve()):
        return (
            f"./{path.resolve().relative_to(folder.resolve()).as_posix()}",
            "keep the wheel in the repository",
        )
    return released, f"bench is installed from {path.name}: keep it in the repository and name it here"


def _find_commit(path: Path) -> str:
    """Return the remote and the commit of a working copy, ``URL@commit``; empty if there are none."""
    found = []
    for command in (("remote", "get-url", "origin"), ("rev-parse", "HEAD")):
        try:
            done = subprocess.run(
                ["git", "-C", str(path), *command], capture_output=True, text=True, timeout=10, check=True
            )
        except (OSError, subprocess.SubprocessError):
            return ""
        found.append(done.stdout.strip())
    remote, commit = found
    if "://" not in remote and ":" in remote:  # git@host:owner/name
        user_host, _, rest = remote.partition(":")
        remote = f"ssh://{user_host}/{rest}"
    parts = urlsplit(remote)
    if parts.scheme not in ("https", "http", "ssh"):
        return ""
    if parts.scheme != "ssh" and parts.username:  # a token is nobody else's business
        remote = parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()
    return f"{remote}@{commit}"
