"""The verb ``sheet``: say where the figures of a sensor of the catalog come from."""

import click

import bench


@click.command()
@click.argument("name")
def sheet(name: str) -> int:
    """Print the title and the source of a sensor of the catalog."""
    found = next((one for one in bench.list_sensors() if one.name == name), None)
    if found is None:
        raise bench.ConfigError(f"sensor {name!r} is not in the catalog")
    click.echo(f"{found.title}: {found.note}")
    return 0
