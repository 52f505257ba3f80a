"""What belongs in each room of an office."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural import fixtures as fit
from gn0.scenes.procedural import groups_office as groups
from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue import bath, home, kitchen, office, tools
from gn0.scenes.procedural.catalogue import fixtures as fix
from gn0.scenes.procedural.catalogue.clutter import crockery, electronics, on_floor, on_table
from gn0.scenes.procedural.catalogue.decor import greenery, pictures, windows
from gn0.scenes.procedural.catalogue.seats import chairs, sofas
from gn0.scenes.procedural.catalogue.storage import books, cloakroom, cupboards
from gn0.scenes.procedural.groups import (
    hang_over,
    hang_pictures,
    place_corner_things,
    place_dining,
    stand_at,
)
from gn0.scenes.procedural.layout import Block, RoomLayout, dress, footprint
from gn0.scenes.procedural.room_contents import furnish_kitchen

COMPANIES = ("NORDLICHT", "AXIOM", "VELA LABS", "MERIDIAN", "HALDEN+CO", "OCTAVE", "KESTREL")


class OfficeRooms:
    """Furnishes the rooms of one office in one furniture line."""

    def __init__(self, taste: groups.OfficeTaste, kelvin: float, company: str) -> None:
        self.taste, self.kelvin, self.company = taste, kelvin, company

    def furnish(self, layout: RoomLayout) -> None:
        """Place everything that belongs in the layout's room."""
        recipe = {
            "open office": self.furnish_hall,
            "reception": self.furnish_reception,
            "meeting room": self.furnish_meeting,
            "office": self.furnish_private,
            "print room": self.furnish_print,
            "server room": self.furnish_server,
            "kitchen": self.furnish_kitchen,
            "toilet": self.furnish_toilet,
        }
        recipe[layout.room.type](layout)

    def finish_room(self, layout: RoomLayout, *, pitch: float = 2.6, vents: int = 1) -> None:
        """Lamps, vents, sockets, switches."""
        fit.light_grid(layout, self.kelvin, pitch=pitch)
        room = layout.room
        across = max(1, round(room.width * vents / 5.0)), max(1, round(room.depth * vents / 5.0))
        fit.put_in_grid(layout, fix.build_vent(), *across, 0.85)
        spray = max(1, round(room.width / 3.0)), max(1, round(room.depth / 3.0))
        fit.put_in_grid(layout, fix.build_sprinkler(), *spray, -0.6)
        fit.fit_fixtures(layout)

    def furnish_hall(self, layout: RoomLayout) -> None:
        """Islands of desks, shelves of files, printers, a corner to sit, boards and plants."""
        rng, palette = layout.rng, layout.palette
        dress_office_windows(layout)
        groups.place_islands(layout, self.taste, share=0.92)
        groups.place_lounge(layout, int(rng.integers(2, 4)))
        copier = office.build_copier(rng)
        if layout.place_on_wall(copier, prefer="any", front=0.5) is not None:
            layout.place_on_wall(on_floor.build_bin(rng, palette), prefer="any", reach=False)
        for _ in range(round(layout.room.area / 22)):
            layout.place_on_wall(groups.build_file_wall(rng, palette), prefer="any")
        for _ in range(round(layout.room.area / 40)):
            layout.place_on_wall(groups.build_low_shelf(rng, palette, self.taste), prefer="any")
        code = str(rng.choice(["#c9ccce", "#5f7a8c", "#8a9a7c", "#e1e0db"]))
        for _ in range(2):
            lockers = office.build_lockers(rng, code, int(rng.integers(3, 6)), 2)
            layout.place_on_wall(lockers, prefer="any", front=0.4)
        layout.place_on_wall(office.build_coat_stand(rng, palette), prefer="any", reach=False)
        layout.place_on_wall(office.build_flip_chart(rng), prefer="any", gap=0.1, reach=False)
        layout.place_on_wall(fix.build_cooler(rng), prefer="any", reach=False)
        fit.stand_extinguisher(layout)
        place_corner_things(layout, plants=round(layout.room.area / 30) + 2, basket=False)
        fit.hang_over_exits(layout, fix.build_exit_sign())
        for board in (office.build_whiteboard(rng, 1.8), office.build_whiteboard(rng, 1.5)):
            fit.hang_somewhere(layout, board, 1.5, middle=True)
        fit.hang_somewhere(layout, fix.build_notice_board(rng, palette, 1.6), 1.5)
        fit.hang_somewhere(layout, pictures.build_clock(rng, palette), 2.15)
        hang_pictures(layout, 4)
        self.finish_room(layout, pitch=2.4)

    def furnish_reception(self, layout: RoomLayout) -> None:
        """A counter before the company's name, seats for those who wait, plants."""
        rng, palette = layout.rng, layout.palette
        dress_office_windows(layout, radiators=False)
        self._place_counter(layout)
        if not groups.place_lounge(layout, int(rng.integers(2, 4))):
            sofa = sofas.build_sofa(rng, palette, seats=2)
            layout.place_on_wall(sofa, prefer="any", gap=0.05)
        chair = sofas.build_sofa(rng, palette, seats=1)
        layout.place_on_wall(chair, prefer="any", gap=0.05, front=0.4)
        layout.place_on_wall(office.build_coat_stand(rng, palette), prefer="corner", reach=False)
        stand = cloakroom.build_umbrella_stand(rng, palette)
        layout.place_on_wall(stand, prefer="corner", reach=False)
        place_corner_things(layout, plants=4, basket=False)
        fit.hang_over_exits(layout, fix.build_exit_sign())
        fit.hang_somewhere(layout, groups.build_wall_screen(rng, 1.2), 1.6)
        hang_pictures(layout, 3, clock=True)
        self.finish_room(layout)

    def _place_counter(self, layout: RoomLayout) -> None:
        """The reception desk with its back to the longest bare wall, room to sit behind it."""
        rng, palette = layout.rng, layout.palette
        width = float(rng.uniform(1.7, 2.4))
        desk = office.build_reception_desk(rng, palette, width)
        bar, work = desk.supports
        parts = [
            Placed(electronics.build_monitor(rng), -0.3, 0.12, work.z, math.pi),
            Placed(electronics.build_keyboard(rng), -0.3, 0.3, work.z, math.pi),
            Placed(electronics.build_mouse(rng), -0.65, 0.3, work.z),
            Placed(office.build_phone(), 0.35, 0.2, work.z, math.pi),
            Placed(tools.build_papers(rng), 0.7, 0.25, work.z),
            Placed(tools.build_pen_holder(rng), bar.x0 + 0.1, -0.28, bar.z),
            Placed(greenery.build_vase(rng, palette, flowers=True), bar.x1 - 0.1, -0.28, bar.z),
            Placed(on_table.build_magazines(rng, palette), 0.15, -0.28, bar.z),
        ]
        desk = desk.with_parts(parts)
        chair = groups.draw_chair(self.taste, palette)
        spots = []
        for high in (2.0, 0.8):  # a bare wall behind it, or else one with windows
            for side in layout.sides.values():
                free = layout.intervals(side, 1.9, high)
                spots += [(high < 1, a - b, side, a, b) for a, b in free if b - a > width + 0.9]
        for _, _, side, a, b in sorted(spots, key=lambda g: (g[0], g[1])):
            t = a + width / 2 + 0.15 if rng.random() < 0.5 else b - width / 2 - 0.15
            at = stand_at(side, t, 1.45, desk)
            seat = stand_at(side, t + 0.2, 0.62, chair, math.pi + float(rng.normal(0, 0.3)))
            clear = layout.strip(side, t - width / 2, t + width / 2, 1.9)
            if layout.place_free([(at, True), (seat, True)], clear):
                sign = fix.build_sign(
                    self.company, min(width * 0.8, 1.8), 0.4, ground="#f0eee9", ink="#2a3540"
                )
                layout.hang(side, sign, t, 1.9)
                return

    def furnish_meeting(self, layout: RoomLayout) -> None:
        """A table with chairs, a screen, whiteboards, a sideboard."""
        rng, palette = layout.rng, layout.palette
        dress_office_windows(layout)
        groups.place_meeting(layout)
        short = ("west", "east") if layout.room.width >= layout.room.depth else ("south", "north")
        tv = groups.build_wall_screen(rng, 1.5)
        if fit.hang_somewhere(layout, tv, 1.45, sides=short, middle=True) is None:
            fit.hang_somewhere(layout, tv, 1.45, middle=True)
        fit.hang_somewhere(layout, office.build_whiteboard(rng, 1.8), 1.5, middle=True)
        board = office.build_low_cabinet(rng, self.taste.front, 1.2)
        things = [crockery.build_glass(rng, palette) for _ in range(5)]
        things += [crockery.build_bottle(rng, palette) for _ in range(3)]
        things += [kitchen.build_coffee_machine(rng)] if rng.random() < 0.5 else []
        board = dress(board, "counter", rng, palette, count=1, first=things)
        layout.place_on_wall(board, prefer="any")
        layout.place_on_wall(office.build_flip_chart(rng), prefer="corner", gap=0.05, reach=False)
        place_corner_things(layout, plants=2, basket=False, widest=0.7)
        layout.place_on_wall(on_floor.build_bin(rng, palette), prefer="corner", reach=False)
        hang_pictures(layout, 2, clock=rng.random() < 0.5)
        self.finish_room(layout, pitch=2.2)

    def furnish_private(self, layout: RoomLayout) -> None:
        """A desk with two visitor chairs, files, a small table."""
        rng, palette = layout.rng, layout.palette
        dress_office_windows(layout)
        desk = groups.build_work_place(rng, palette, self.taste)
        spot = layout.place_on_wall(desk, prefer="any", gap=0.03, front=0.9)
        if spot is not None:
            chair = groups.draw_chair(self.taste, palette)
            c, s = math.cos(spot.yaw), math.sin(spot.yaw)
            y = -self.taste.depth / 2 - float(rng.uniform(0.1, 0.25))
            at = Placed(chair, spot.x - s * y, spot.y + c * y, 0.0, spot.yaw + math.pi + 0.2)
            layout.reach = [p for p in layout.reach if math.dist(p, (at.x, at.y)) > 0.6]
            layout.placed.append(at)
            layout.blocks.append(Block(footprint(at), 1.1))
        for _ in range(2):
            layout.place_on_wall(groups.build_file_wall(rng, palette), prefer="corner", front=0.3)
        shelf = dress(books.build_bookshelf(rng, palette), "shelf", rng, palette, count=8)
        layout.place_on_wall(shelf, prefer="corner", front=0.3)
        layout.place_on_wall(groups.build_low_shelf(rng, palette, self.taste), prefer="any")
        model, kind = int(rng.integers(2**31)), int(rng.integers(4))
        for _ in range(2):
            chair = chairs.build_chair(
                np.random.Generator(np.random.Philox(key=model)), palette, kind
            )
            layout.place_on_wall(chair, prefer="any", gap=0.05, reach=False)
        place_corner_things(layout, plants=2, basket=False, widest=0.8)
        layout.place_on_wall(office.build_coat_stand(rng, palette), prefer="corner", reach=False)
        if rng.random() < 0.6:
            fit.hang_somewhere(layout, office.build_whiteboard(rng, 1.2), 1.5, middle=True)
        hang_pictures(layout, 3, clock=rng.random() < 0.3)
        self.finish_room(layout, pitch=2.2)

    def furnish_print(self, layout: RoomLayout) -> None:
        """Copiers, packets of paper on shelves, a table for sorting."""
        rng, palette = layout.rng, layout.palette
        for _ in range(2):
            layout.place_on_wall(office.build_copier(rng), prefer="corner", front=0.5)
        for _ in range(2):
            stock: list[Item] = [office.build_paper_pack(rng) for _ in range(14)]
            stock += [cupboards.build_storage_box(rng, palette) for _ in range(4)]
            stock += [tools.build_tray(rng) for _ in range(2)]
            rack = home.build_utility_shelf(rng, float(rng.uniform(0.8, 1.0)))
            rack = dress(rack, "shelf", rng, palette, count=0, first=stock, turn=0.06)
            layout.place_on_wall(rack, prefer="corner")
        table = office.build_work_desk(self.taste.top, self.taste.frame, 1.2, 0.6)
        small: list[Item] = [tools.build_tray(rng), tools.build_stapler(rng)]
        small += [tools.build_papers(rng) for _ in range(2)] + [tools.build_pen_holder(rng)]
        table = dress(table, "desk", rng, palette, count=1, first=small)
        layout.place_on_wall(table, prefer="any")
        layout.place_on_wall(groups.build_file_wall(rng, palette), prefer="corner")
        for _ in range(2):
            layout.place_on_wall(on_floor.build_bin(rng, palette), prefer="corner", reach=False)
        fit.hang_somewhere(layout, fix.build_notice_board(rng, palette), 1.5)
        self.finish_room(layout)

    def furnish_server(self, layout: RoomLayout) -> None:
        """Racks, shelves of boxes, an extinguisher."""
        rng, palette = layout.rng, layout.palette
        for _ in range(int(rng.integers(2, 4))):
            layout.place_on_wall(office.build_server_rack(rng), prefer="corner", front=0.6)
        for _ in range(2):
            stock = [cupboards.build_storage_box(rng, palette) for _ in range(9)]
            stock += [electronics.build_monitor(rng), electronics.build_keyboard(rng)]
            rack = home.build_utility_shelf(rng, 0.9)
            rack = dress(rack, "shelf", rng, palette, count=0, first=stock, turn=0.1)
            layout.place_on_wall(rack, prefer="corner")
        fit.stand_extinguisher(layout)
        self.finish_room(layout)

    def furnish_kitchen(self, layout: RoomLayout) -> None:
        """A counter and tables, a vending machine, a cooler, many cups."""
        rng, palette = layout.rng, layout.palette
        furnish_kitchen(layout)
        layout.placed = [p for p in layout.placed if p.item.category != "ceiling lamp"]
        for k, placed in enumerate(layout.placed):
            if placed.item.category == "kitchen counter":
                cups = [crockery.build_cup(rng, palette) for _ in range(7)]
                cups += [crockery.build_plates(rng, palette) for _ in range(2)]
                more = dress(placed.item, "counter", rng, palette, count=0, first=cups)
                layout.placed[k] = Placed(more, placed.x, placed.y, placed.z, placed.yaw)
        layout.place_on_wall(fix.build_vending_machine(rng), prefer="corner", front=0.5)
        layout.place_on_wall(fix.build_cooler(rng), prefer="any", reach=False)
        if layout.room.area > 17:
            place_dining(layout, 4, kelvin=3500.0)
        fit.hang_somewhere(layout, fix.build_notice_board(rng, palette, 1.0), 1.5)
        self.finish_room(layout)

    def furnish_toilet(self, layout: RoomLayout) -> None:
        """Toilet, washbasin with mirror, dispensers, a bin."""
        furnish_washroom(layout)
        self.finish_room(layout)


def furnish_washroom(layout: RoomLayout) -> None:
    """A small public toilet: bowl, basin with mirror, dispensers, bin and brush."""
    rng, palette = layout.rng, layout.palette
    basin = dress(bath.build_washbasin(rng, palette), "bath", rng, palette, count=1)
    spot = layout.place_on_wall(basin, prefer="any", gap=0.005, front=0.4, margin=0.05)
    bowl = bath.build_toilet(rng)
    toilet = layout.place_on_wall(bowl, prefer="any", gap=0.005, front=0.45, margin=0.1)
    if spot is not None:
        hang_over(layout, spot, pictures.build_mirror(rng, palette, 0.55, 0.75), 1.55)
    if toilet is not None:
        layout.place_on_wall(bath.build_toilet_brush(), prefer="any", gap=0.03, reach=False)
        hang_over(layout, toilet, fix.build_poster(rng, "WASH HANDS", 0.4, 0.55), 1.6)
    fit.hang_somewhere(layout, bath.build_paper_roll(rng), 0.75)
    for z in (1.15, 1.25):
        fit.hang_somewhere(layout, fix.build_dispenser(), z)
    layout.place_on_wall(on_floor.build_bin(rng, palette), prefer="corner", reach=False)


def dress_office_windows(layout: RoomLayout, *, radiators: bool = True) -> None:
    """Roller blinds, partly down, and a radiator under each window with a parapet."""
    rng, palette = layout.rng, layout.palette
    for side in layout.sides.values():
        for a, b, bottom, top, opening in side.openings:
            if opening.kind != "window":
                continue
            middle, width = (a + b) / 2, b - a
            blind = windows.build_blind(rng, palette, width + 0.06, top - bottom)
            layout.placed.append(Placed(blind, *side.point(middle, 0.005), top + 0.06, side.yaw))
            layout.hung[side.name].append((a - 0.1, bottom, b + 0.1, top + 0.1))
            if radiators and bottom > 0.7 and width > 1.0:
                radiator = windows.build_radiator(rng, min(width - 0.3, 1.4))
                at = stand_at(side, middle, 0.0, radiator)
                if layout.is_clear(footprint(at)):
                    layout.add(at)
