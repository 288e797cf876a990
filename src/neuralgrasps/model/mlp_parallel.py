"""The processes that train together under torchrun, or this one alone."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

import torch
from torch import distributed, nn
from torch.nn.parallel import DistributedDataParallel

from neuralgrasps.errors import DeviceError


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """This process among `count` that train together.

    Attributes:
        rank: 0 to count - 1; the first one writes files. device: where this one trains.
    """

    rank: int
    count: int
    device: torch.device

    def wrapped(self, model: nn.Module) -> nn.Module:
        """The model with gradients averaged over all workers."""
        if self.count == 1:
            return model
        ids = [self.device.index] if self.device.type == "cuda" else None
        return DistributedDataParallel(model, device_ids=ids)

    def own_randomness(self) -> AbstractContextManager[None]:
        """Inside, torch's global generators may be seeded; afterwards they are as before."""
        devices = [self.device] if self.device.type == "cuda" else []
        return torch.random.fork_rng(devices=devices)

    def any(self, flag: bool) -> bool:
        """Whether any worker says so; all get the same answer."""
        if self.count == 1:
            return flag
        told = torch.tensor(float(flag), device=self.device)
        distributed.all_reduce(told, op=distributed.ReduceOp.MAX)
        return bool(told > 0)


def chosen_device(device: torch.device | str | None) -> torch.device:
    """The device asked for; None: this process's GPU if there is one, else the processor.

    Raises:
        DeviceError: it is not there.
    """
    local = int(os.environ.get("LOCAL_RANK", "0"))
    if device is None:
        return torch.device("cuda", local) if torch.cuda.is_available() else torch.device("cpu")
    try:
        chosen = torch.device(device)
        if chosen.type not in ("cpu", "cuda"):
            raise DeviceError(f"device '{device}' cannot be used by this field. Expected 'cpu' or 'cuda'.")
        if chosen.type == "cuda" and chosen.index is None:
            chosen = torch.device("cuda", local)
        torch.zeros(1, device=chosen)
    except (RuntimeError, AssertionError, TypeError) as error:
        raise DeviceError(
            f"device '{device}' cannot be used: {error}. Expected 'cpu', or 'cuda' where there is a GPU."
        ) from error
    return chosen


def worker_count() -> int:
    """How many processes train together."""
    return int(os.environ.get("WORLD_SIZE", "1"))


def is_first_worker() -> bool:
    """Whether this process is the one that writes files."""
    return int(os.environ.get("RANK", "0")) == 0


@contextmanager
def workers_here(device: torch.device | str | None = None) -> Iterator[Workers]:
    """All processes that torchrun started (its environment says so), or this one alone."""
    count = worker_count()
    mine = chosen_device(device)
    if count == 1:
        yield Workers(rank=0, count=1, device=mine)
        return
    if mine.type == "cuda":
        torch.cuda.set_device(mine)
    joined = not distributed.is_initialized()
    if joined:
        distributed.init_process_group("nccl" if mine.type == "cuda" else "gloo")
    try:
        yield Workers(rank=distributed.get_rank(), count=count, device=mine)
    finally:
        if joined:
            distributed.destroy_process_group()
