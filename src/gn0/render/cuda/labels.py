"""Labels of pictures on a device: which category and which object each pixel shows.

Found from the lists that colours are drawn from, by kernels of their own (`kernels/labels.cuh`), so
that those of colours are the same with labels and without. See `gn0.render.labels` for the rule.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from gn0.device.device import Device, DeviceArray, Kernel
from gn0.render.cuda.cloud import CloudDevice, build_clouds
from gn0.render.cuda.instances import PART
from gn0.render.cuda.lists import LabelTarget, Lists
from gn0.render.cuda.records import FindParts, LabelParts, LabelPictures, LabelTiles, PartTables
from gn0.render.cuda.replay import PicturesDevice
from gn0.render.cuda.source import CODES, label_source
from gn0.render.cuda.tune import Tuning
from gn0.render.cuda.work import Work, WorkDevice
from gn0.render.labels import check_labelled
from gn0.render.renderer import LABELS, OUTPUTS


class LabelDrawer:
    """Finds labels on one device, from lists that others made.

    Args:
        device: draws.
    """

    codes = CODES  # that a pixel has room for at a time; never changes a byte

    def __init__(self, device: Device) -> None:
        self._device = device
        self._loaded: dict[tuple[Tuning, bool, bool], Mapping[str, Kernel]] = {}
        self._clouds: tuple[bytes, DeviceArray] | None = None

    def prepare(
        self,
        work: Work,
        scenes: Sequence[CloudDevice | None],
        pictures: PicturesDevice,
        *,
        who: bool = False,
    ) -> LabelTarget | None:
        """What a call's labels need; None where it wants none.

        Args:
            work: the call.
            scenes: its clouds that are neither moving splats nor instances.
            pictures: what to fill.
            who: instead of objects, each view's instances are told apart, by their place from 1.

        Raises:
            RenderError: a scene carries no labels, or numbers that a code cannot hold.
            DeviceMemoryError: there is no room for the codes.
        """
        wanted = [name for name in LABELS if getattr(pictures, name) is not None]
        if not wanted:
            return None
        if who:
            table = work.table.copy()
            table["sh"] = 0
            there = self._device.upload(table.view(np.uint32))
            return LabelTarget(None, pictures.instance, there, alone=True, who=True)
        for cloud in scenes:
            if cloud is not None:
                known = cloud.labels
                check_labelled(known, None if known is None else known.categories, wanted)
        table = work.table.copy()
        for number, cloud in enumerate(work.held):
            table["sh"][number] = 0
            if cloud is not None and cloud.labels is not None:
                codes = cloud.labels.bring(self._device, cloud.order, cloud.alive)
                table["sh"][number] = codes.pointer
        if work.part_table is not None:
            for slot, cloud in enumerate(work.part_table.clouds, start=work.base):
                if cloud is not None:
                    table[slot] = build_clouds([cloud])[0]
                    table["sh"][slot] = 0
                    if cloud.labels is not None:
                        codes = cloud.labels.bring(self._device, cloud.order, cloud.alive)
                        table["sh"][slot] = codes.pointer
        key = table.tobytes()
        if self._clouds is None or self._clouds[0] != key:
            self._clouds = (key, self._device.upload(table.view(np.uint32)))
        alone = all(getattr(pictures, name) is None for name in OUTPUTS)
        return LabelTarget(pictures.semantic, pictures.instance, self._clouds[1], alone)

    def arrange(
        self, work: Work, lists: Lists, tuning: Tuning, target: LabelTarget
    ) -> Callable[[], None]:
        """All that may fail of finding the labels of a batch; what it gives launches the rest.

        Raises:
            DeviceMemoryError: there is no room for a table of instances.
        """
        kernels = self._load(tuning, work.instances is not None, target.who)
        given = lists.to_draw(target.clouds)
        pictures = LabelPictures(target.semantic, target.instance)
        if work.instances is None:
            return lambda: kernels["label_tiles"].launch(
                lists.blocks, tuning.threads, LabelTiles(given, pictures)
            )
        assert lists.parts is not None
        views, count = lists.parts.part_views, len(work.instances)
        if not isinstance(work, WorkDevice):  # those of the batch alone
            count = int(work.instances.counts(work.count)[lists.views_of].sum())
        parts = self._device.empty(max(count, 1) * PART.itemsize // 4, np.uint32)

        def launch() -> None:
            found = FindParts(views, np.uint32(count), target.clouds, parts)
            kernels["find_parts"].launch(-(-max(count, 1) // 128), 128, found)
            record = LabelParts(given, pictures, PartTables(views, parts))
            kernels["label_parts"].launch(lists.blocks, tuning.threads, record)

        return launch

    def _load(self, tuning: Tuning, parts: bool, who: bool) -> Mapping[str, Kernel]:
        loaded = self._loaded.get((tuning, parts, who))
        if loaded is None:
            source = label_source(tuning, parts=parts, codes=self.codes, who=who)
            loaded = self._loaded[tuning, parts, who] = self._device.load(source)
        return loaded
