"""What belongs in corridors and in the rooms along them: hotel, school, hospital."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural import fixtures as fit
from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue import bath, home, office, public, tools
from gn0.scenes.procedural.catalogue import fixtures as fix
from gn0.scenes.procedural.catalogue.clutter import electronics, on_floor, on_table
from gn0.scenes.procedural.catalogue.decor import pictures
from gn0.scenes.procedural.catalogue.seats import chairs, sofas
from gn0.scenes.procedural.catalogue.storage import books, cupboards
from gn0.scenes.procedural.catalogue.tables import high_tables, low_tables, rugs
from gn0.scenes.procedural.groups import (
    dress_windows,
    hang_pictures,
    light_ceiling,
    place_bed,
    place_corner_things,
    place_desk,
)
from gn0.scenes.procedural.groups_office import build_wall_screen, draw_taste
from gn0.scenes.procedural.layout import RoomLayout, dress, footprint
from gn0.scenes.procedural.palette import Palette, plain
from gn0.scenes.procedural.rooms_office import OfficeRooms, dress_office_windows, furnish_washroom

POSTERS = {
    "school": ("SCIENCE DAY", "READ MORE", "CHOIR", "MATH CLUB", "SPORTS", "BE KIND"),
    "hospital": ("WASH HANDS", "GIVE BLOOD", "KEEP CALM", "VISITORS", "FIRST AID"),
    "hotel": ("BREAKFAST", "POOL + SPA", "CITY TOUR"),
}
ROW = 1.38  # m between rows of tables in a classroom


class CorridorRooms:
    """Furnishes the rooms of one corridor, all in one line of furniture."""

    def __init__(self, theme: str, palette: Palette, rng: np.random.Generator) -> None:
        self.theme = theme
        self.kelvin = 2900.0 if theme == "hotel" else 4000.0
        self.offices = OfficeRooms(draw_taste(rng, palette), self.kelvin, "")
        self.wood = palette.wood(rng, 0)
        self.code = str(rng.choice(["#3f6f8c", "#8a4a42", "#5f7f5a", "#c2a04a", "#7d8a96"]))
        self.floor = int(rng.integers(1, 5))  # storey, the first digit of the room numbers
        self.chair = int(rng.integers(2**31))

    def furnish(self, layout: RoomLayout) -> None:
        """Place everything that belongs in the layout's room."""
        recipe = {
            "corridor": self.furnish_corridor,
            "niche": self.furnish_niche,
            "hotel room": self.furnish_hotel_room,
            "linen room": self.furnish_linen,
            "classroom": self.furnish_classroom,
            "patient room": self.furnish_patient_room,
            "office": self.offices.furnish_private,
            "toilet": self.furnish_toilet,
        }
        recipe[layout.room.type](layout)

    def furnish_corridor(self, layout: RoomLayout) -> None:
        """Lamps in a row, numbers by the doors, benches, rails, lockers, boards, signs."""
        rng, palette, room = layout.rng, layout.palette, layout.room
        dress_office_windows(layout)
        self._mark_doors(layout)
        self._sign_ends(layout)
        long = max(room.width, room.depth)
        if self.theme == "hotel":
            self._furnish_hotel_leg(layout)
        for _ in range(max(1, round(long / 14))):
            fit.stand_extinguisher(layout)
        if self.theme == "school":
            for _ in range(round(long / 5)):
                bank = office.build_lockers(rng, self.code, int(rng.integers(4, 8)), 2)
                layout.place_on_wall(bank, prefer="any")
        for _ in range(max(1, round(long / 8))):
            bench = (
                chairs.build_bench(rng, palette, 1.3)
                if self.theme == "hotel"
                else public.build_seat_row(rng, palette, int(rng.integers(2, 5)))
            )
            layout.place_on_wall(bench, prefer="any", gap=0.04)
        if self.theme == "hospital":
            layout.place_on_wall(public.build_wheelchair(rng), prefer="any", gap=0.05)
            layout.place_on_wall(public.build_drip_stand(), prefer="any", gap=0.05, reach=False)
            for _ in range(max(1, round(long / 6))):
                fit.hang_somewhere(layout, fix.build_dispenser(), 1.2)
        if rng.random() < 0.6:
            layout.place_on_wall(fix.build_cooler(rng), prefer="any", reach=False)
        if self.theme != "school":
            trolley = public.build_trolley(rng, palette)
            layout.place_on_wall(trolley, prefer="any", gap=0.05, reach=False)
        for _ in range(max(1, round(long / 9))):
            layout.place_on_wall(on_floor.build_bin(rng, palette), prefer="any", reach=False)
        place_corner_things(layout, plants=round(long / 5) + 1, basket=False, widest=0.65)
        if self.theme != "hotel":
            for _ in range(round(long / 7)):
                board = fix.build_notice_board(rng, palette, float(rng.uniform(0.9, 1.5)))
                fit.hang_somewhere(layout, board, 1.55)
            for words in rng.permutation(list(POSTERS[self.theme]))[: round(long / 5)]:
                fit.hang_somewhere(layout, fix.build_poster(rng, str(words)), 1.6)
        if self.theme == "hospital":
            self._fit_rails(layout)
        fit.hang_somewhere(layout, pictures.build_clock(rng, palette), 2.15)
        hang_pictures(layout, round(long / 3))
        self._light_corridor(layout)
        fit.fit_fixtures(layout, sockets=round(long / 4))

    def _furnish_hotel_leg(self, layout: RoomLayout) -> None:
        """A lift, a runner, consoles, lamps on the walls."""
        rng, palette, room = layout.rng, layout.palette, layout.room
        fit.hang_somewhere(layout, public.build_lift_door(), 0.0, middle=True)
        long, short = max(room.width, room.depth), min(room.width, room.depth)
        yaw = 0.0 if room.width >= room.depth else math.pi / 2
        seed = int(rng.integers(2**31))
        pieces = max(1, int(long / 6.5))
        for k in range(pieces):
            model = np.random.Generator(np.random.Philox(key=seed))
            runner = rugs.build_rug(model, palette, long / pieces - 0.8, min(0.9, short - 0.8))
            t = (k + 0.5) / pieces
            x = room.x0 + room.width * (t if yaw == 0.0 else 0.5)
            y = room.y0 + room.depth * (0.5 if yaw == 0.0 else t)
            layout.placed.append(Placed(runner, x, y, 0.0, yaw))
        for _ in range(max(1, round(long / 9))):
            console = dress(
                high_tables.build_console(rng, palette), "sideboard", rng, palette, count=3
            )
            layout.place_on_wall(console, prefer="any", gap=0.01)
        lamp = public.build_wall_lamp(rng, palette, self.kelvin)
        for _ in range(round(long / 2.6)):
            fit.hang_somewhere(layout, lamp, 1.75)

    def _light_corridor(self, layout: RoomLayout) -> None:
        room = layout.room
        long = max(room.width, room.depth)
        wide = room.width >= room.depth

        def put(item: Item, count: int, shift: float, yaw: float = 0.0) -> None:
            columns, rows = (count, 1) if wide else (1, count)
            fit.put_in_grid(layout, item, columns, rows, shift, yaw)

        count = max(1, round(long / 2.8))
        if self.theme == "hotel":
            item = fix.build_panel_lamp(self.kelvin, 0.55 * room.area / count, 0.26, 0.26)
        else:
            item = fix.build_panel_lamp(self.kelvin, 0.75 * room.area / count, 1.2, 0.3)
        put(item, count, 0.0, 0.0 if wide else math.pi / 2)
        put(fix.build_vent(0.4), max(1, count // 3), 0.55)
        put(fix.build_sprinkler(), max(1, round(long / 3.5)), -0.5)

    def _mark_doors(self, layout: RoomLayout) -> None:
        """A number or a name beside each door of the corridor."""
        number = 0
        for side in layout.sides.values():
            for a, b, bottom, _, opening in side.openings:
                if bottom > 0 or opening.kind == "passage":
                    continue
                number += 1
                other = [id for id in opening.rooms if id not in (None, layout.room.id)]
                kind = other[0].rsplit("_", 1)[0] if other and other[0] else ""
                digits = 20 * (int(layout.room.id.rsplit("_", 1)[1]) - 1) + number
                text = {"toilet": "WC", "office": "STAFF", "linen_room": "STORE"}.get(
                    kind, f"{self.floor}{digits:02d}"
                )
                sign = fix.build_sign(text, 0.2, 0.13, ground="#e6e2d8", ink="#24303a")
                if layout.hang(side, sign, b + 0.24, 1.55) is None:
                    layout.hang(side, sign, a - 0.24, 1.55)

    def _sign_ends(self, layout: RoomLayout) -> None:
        """Exit signs over doors to the outside, direction signs over passages."""
        ways = ("ROOMS >", "< LIFT") if self.theme == "hotel" else ("WARD B >", "< EXIT")
        ways = ("ROOMS 1-9", "< HALL") if self.theme == "school" else ways
        for side in layout.sides.values():
            for a, b, bottom, top, opening in side.openings:
                if bottom > 0:
                    continue
                if opening.kind == "entrance":
                    layout.hang(side, fix.build_exit_sign(), (a + b) / 2, top + 0.2)
                elif opening.kind == "passage" and b - a < 4 and b - a > 1.2:
                    text = ways[int(layout.rng.integers(2))]
                    height = min(0.2, layout.plan.ceiling - top - 0.08)
                    if height > 0.1:
                        sign = fix.build_sign(text, height * 5.5, height)
                        layout.hang(side, sign, (a + b) / 2, top + 0.02 + height / 2 + 0.07)

    def _fit_rails(self, layout: RoomLayout) -> None:
        """Rails for hands along the bare walls."""
        for side in layout.sides.values():
            for a, b in layout.wall_gaps(side, 0.8, 1.0):
                if b - a > 1.0:
                    length = min(b - a - 0.1, 4.0)
                    layout.hang(side, public.build_handrail(self.wood, length), (a + b) / 2, 0.9)

    def furnish_niche(self, layout: RoomLayout) -> None:
        """A place to sit, or a machine."""
        rng, palette = layout.rng, layout.palette
        if self.theme == "hotel":
            layout.place_on_wall(sofas.build_sofa(rng, palette, seats=2), prefer="centre", gap=0.04)
        else:
            row = public.build_seat_row(rng, palette, 3)
            layout.place_on_wall(row, prefer="centre", gap=0.05)
            layout.place_on_wall(fix.build_vending_machine(rng), prefer="corner", reach=False)
        table = dress(
            low_tables.build_side_table(rng, palette), "nightstand", rng, palette, count=1,
            first=[on_table.build_magazines(rng, palette)],
        )  # fmt: skip
        layout.place_on_wall(table, prefer="any", gap=0.05, reach=False)
        place_corner_things(layout, plants=2, basket=False, widest=0.7)
        hang_pictures(layout, 2)
        fit.light_grid(layout, self.kelvin, flux=0.8)
        fit.fit_fixtures(layout, sockets=2)

    def furnish_hotel_room(self, layout: RoomLayout) -> None:
        """A bed with lamps, a desk, a wardrobe, a screen, a suitcase."""
        rng, palette = layout.rng, layout.palette
        dress_windows(layout)
        if place_bed(layout, True, 2700.0) is None:
            place_bed(layout, False, 2700.0)
        wardrobe = cupboards.build_wardrobe(rng, palette)
        layout.place_on_wall(wardrobe, prefer="corner", front=0.4)
        place_desk(layout, kelvin=2900.0)
        layout.place_on_wall(on_floor.build_suitcase(rng, palette), prefer="any", reach=False)
        layout.place_on_wall(sofas.build_sofa(rng, palette, seats=1), prefer="corner", gap=0.08)
        place_corner_things(layout, plants=1, lamp=2700.0, basket=False)
        layout.place_on_wall(on_floor.build_bin(rng, palette), prefer="corner", reach=False)
        fit.hang_somewhere(layout, build_wall_screen(rng, 1.0), 1.4, middle=True)
        fit.hang_somewhere(layout, pictures.build_mirror(rng, palette, 0.5, 1.3), 1.2)
        hang_pictures(layout, 2)
        light_ceiling(layout, 2900.0)
        fit.fit_fixtures(layout)

    def furnish_linen(self, layout: RoomLayout) -> None:
        """Shelves of towels and boxes, a trolley, laundry baskets."""
        rng, palette = layout.rng, layout.palette
        for _ in range(3):
            stock: list[Item] = [cupboards.build_towel_stack(rng, palette) for _ in range(9)]
            stock += [cupboards.build_storage_box(rng, palette) for _ in range(3)]
            stock += [home.build_detergent(rng) for _ in range(5)]
            rack = home.build_utility_shelf(rng, 0.9)
            rack = dress(rack, "bath", rng, palette, count=0, first=stock, turn=0.08)
            layout.place_on_wall(rack, prefer="corner")
        trolley = public.build_trolley(rng, palette)
        layout.place_on_wall(trolley, prefer="any", gap=0.05, reach=False)
        for _ in range(2):
            basket = bath.build_laundry(rng, palette)
            layout.place_on_wall(basket, prefer="corner", reach=False)
        fit.light_grid(layout, 4000.0)
        fit.fit_fixtures(layout)

    def furnish_classroom(self, layout: RoomLayout) -> None:
        """Rows of tables for two before a blackboard, the teacher's desk, shelves, posters."""
        rng, palette = layout.rng, layout.palette
        dress_office_windows(layout)
        sides = sorted(
            layout.sides.values(),
            key=lambda s: (any(o[4].kind == "window" for o in s.openings), s.length),
        )
        for side in sides:
            gaps = [g for g in layout.wall_gaps(side, 0.8, 2.2) if g[1] - g[0] > 2.4]
            if gaps:
                break
        else:
            side, gaps = sides[0], []
        if gaps:
            wide = min(3.2, gaps[0][1] - gaps[0][0] - 0.3)
            layout.hang(side, public.build_blackboard(rng, wide), sum(gaps[0]) / 2, 1.5)
        self._seat_class(layout, side.name)
        for _ in range(3):
            shelf = dress(books.build_bookshelf(rng, palette), "shelf", rng, palette, count=7)
            layout.place_on_wall(shelf, prefer="corner")
        low = office.build_low_cabinet(rng, self.offices.taste.front, 1.2)
        low = dress(low, "shelf", rng, palette, count=2, first=[public.build_globe(rng, palette)])
        layout.place_on_wall(low, prefer="any")
        place_corner_things(layout, plants=2, basket=False, widest=0.7)
        layout.place_on_wall(on_floor.build_bin(rng, palette), prefer="corner", reach=False)
        for words in rng.permutation(list(POSTERS["school"]))[:4]:
            fit.hang_somewhere(layout, fix.build_poster(rng, str(words), 0.5, 0.7), 1.6)
        fit.hang_somewhere(layout, fix.build_notice_board(rng, palette, 1.2), 1.55)
        fit.hang_somewhere(layout, pictures.build_clock(rng, palette), 2.1)
        fit.light_grid(layout, self.kelvin, long=True)
        fit.fit_fixtures(layout)

    def _seat_class(self, layout: RoomLayout, front: str) -> None:
        """Tables in rows that face the wall `front`, and a desk before them."""
        rng, palette = layout.rng, layout.palette
        side = layout.sides[front]
        across = layout.room.depth if front in ("south", "north") else layout.room.width
        frame = plain("tube", "metal", "#5f656b", contrast=0.15)
        columns = max(int((side.length - 1.6) / 1.85), 1)
        rows = max(int((across - 2.9) / ROW), 1)
        desk = dress(
            high_tables.build_desk(rng, palette), "desk", rng, palette, count=2,
            first=[electronics.build_laptop(rng, palette)],
        )  # fmt: skip
        x, y = side.point(side.length * 0.5 + float(rng.uniform(-0.8, 0.8)), 1.45)
        teacher = Placed(desk, x, y, 0.0, side.yaw + math.pi)
        seat = chairs.build_chair(np.random.Generator(np.random.Philox(key=self.chair)), palette, 0)
        x, y = side.point(
            (x - side.start[0]) * side.along[0] + (y - side.start[1]) * side.along[1], 0.85
        )
        group = [(teacher, True), (Placed(seat, x, y, 0.0, side.yaw + 0.2), True)]
        if not layout.place_free(group, footprint(teacher)):
            layout.place_free(group[:1], footprint(teacher))
        for i in range(columns):
            for j in range(rows):
                t = side.length / 2 + (i - (columns - 1) / 2) * 1.85
                off = 2.75 + j * ROW
                table = public.build_pupil_desk(self.wood, frame)
                kit: list[Item] = [tools.build_notebook(rng) for _ in range(2)]
                kit += [books.build_book_stack(rng, 1), tools.build_pen_holder(rng)]
                keep = [item for item in kit if rng.random() < 0.7]
                table = dress(table, "desk", rng, palette, count=0, first=keep)
                x, y = side.point(t, off)
                group = [(Placed(table, x, y, 0.0, side.yaw + math.pi), True)]
                for s in (-1, 1):
                    model = np.random.Generator(np.random.Philox(key=self.chair))
                    chair = chairs.build_chair(model, palette, 1)
                    px, py = side.point(t + s * 0.33, off + 0.38 + float(rng.uniform(0, 0.1)))
                    turn = float(rng.normal(0, 0.12))
                    group.append((Placed(chair, px, py, 0.0, side.yaw + math.pi + turn), True))
                rects = [footprint(p) for p, _ in group]
                clear = (
                    min(q[0] for q in rects), min(q[1] for q in rects),
                    max(q[2] for q in rects), max(q[3] for q in rects),
                )  # fmt: skip
                layout.place_free(group, clear)

    def furnish_patient_room(self, layout: RoomLayout) -> None:
        """One or two beds with cabinets, drip stands, a visitor's chair, a screen."""
        rng, palette = layout.rng, layout.palette
        dress_windows(layout, curtains=True)
        for _ in range(2 if layout.room.area > 17 else 1):
            bed = layout.place_on_wall(
                public.build_hospital_bed(rng), prefer="any", gap=0.05, margin=0.5
            )
            if bed is None:
                continue
            stand = dress(
                low_tables.build_nightstand(rng, palette), "nightstand", rng, palette, count=2
            )
            layout.place_on_wall(stand, prefer="any", reach=False)
            layout.place_on_wall(public.build_drip_stand(), prefer="any", gap=0.1, reach=False)
        layout.place_on_wall(cupboards.build_wardrobe(rng, palette), prefer="corner", front=0.4)
        basin = dress(bath.build_washbasin(rng, palette), "bath", rng, palette, count=1)
        layout.place_on_wall(basin, prefer="any", front=0.4)
        for _ in range(2):
            layout.place_on_wall(chairs.build_chair(rng, palette, 2), prefer="any", gap=0.05)
        layout.place_on_wall(on_floor.build_bin(rng, palette), prefer="corner", reach=False)
        fit.hang_somewhere(layout, build_wall_screen(rng, 0.9), 1.9)
        fit.hang_somewhere(layout, fix.build_dispenser(), 1.2)
        place_corner_things(layout, plants=1, basket=False, widest=0.6)
        hang_pictures(layout, 2, clock=True)
        fit.light_grid(layout, self.kelvin, long=True)
        fit.fit_fixtures(layout)

    def furnish_toilet(self, layout: RoomLayout) -> None:
        """A public toilet."""
        furnish_washroom(layout)
        fit.light_grid(layout, self.kelvin)
        fit.fit_fixtures(layout, sockets=1)
