;; Common functions: records of the tables, and moving words and bytes.
;;
;; An invalid block traps, which is a bug of lfield, and ends its agent: no reference leads to the block of
;; another one.
;;
;; The tables of a program (runtime_tables.py): sixteen addresses, by kind, of records of 16 bytes, by index, then their
;; numbers. Addresses in them count from the start of the tables. A record: a number, the number of references (-1:
;; all words after the header), the address of their list, another number. An entry of a list: the offset of
;; a reference in bytes, and its target type.

(func $record (param $tables i32) (param $header_low i32) (result i32)
    (local $kind i32)
    (local.set $kind
        (i32.add (local.get $tables) (i32.shl (i32.and (local.get $header_low) (i32.const 15)) (i32.const 2))))
    ;; No table has it: it is not an object.
    (if (i32.or
            (i32.gt_u (i32.and (local.get $header_low) (i32.const 255)) (i32.const 15))
            (i32.ge_u
                (i32.shr_u (local.get $header_low) (i32.const 8))
                (i32.load offset=64 (local.get $kind))))
        (then unreachable))
    (i32.add
        (i32.add (local.get $tables) (i32.load (local.get $kind)))
        (i32.shl (i32.shr_u (local.get $header_low) (i32.const 8)) (i32.const 4))))

;; The address of a word of a block.
(func $address (param $base i32) (param $index i64) (result i32)
    (i32.add (local.get $base) (i32.shl (i32.wrap_i64 (local.get $index)) (i32.const 3))))

;; Moves bytes; a few of them are moved faster here than by memory.copy.
(func $move (param $to i32) (param $from i32) (param $count i32)
    (if (i32.gt_u (local.get $count) (i32.const 256))
        (then
            (memory.copy (local.get $to) (local.get $from) (local.get $count))
            (return)))
    (block $done
        (loop $words
            (br_if $done (i32.lt_u (local.get $count) (i32.const 8)))
            (i64.store align=1 (local.get $to) (i64.load align=1 (local.get $from)))
            (local.set $to (i32.add (local.get $to) (i32.const 8)))
            (local.set $from (i32.add (local.get $from) (i32.const 8)))
            (local.set $count (i32.sub (local.get $count) (i32.const 8)))
            (br $words)))
    (block $done
        (loop $bytes
            (br_if $done (i32.eqz (local.get $count)))
            (i32.store8 (local.get $to) (i32.load8_u (local.get $from)))
            (local.set $to (i32.add (local.get $to) (i32.const 1)))
            (local.set $from (i32.add (local.get $from) (i32.const 1)))
            (local.set $count (i32.sub (local.get $count) (i32.const 1)))
            (br $bytes))))

;; Moves the elements of a growable array to an array at $top with space for half as many more, as in
;; lfield/vm/memory/block.py; its size in words. 0 without effect if it does not fit before $end, or is long.
(func $grow (export "grow")
    (param $base i32) (param $index i64) (param $top i64) (param $end i64) (param $max_length i64)
    (result i64)
    (local $address i32) (local $from i32) (local $to i32) (local $length i64) (local $capacity i64)
    (local.set $address (call $address (local.get $base) (local.get $index)))
    (local.set $length (i64.load offset=8 (local.get $address)))
    (if (i64.gt_u (local.get $length) (i64.const 8192)) (then (return (i64.const 0))))
    (local.set $capacity
        (i64.add
            (i64.add (local.get $length) (i64.shr_u (local.get $length) (i64.const 1)))
            (i64.const 4)))
    (if (i64.gt_u (local.get $capacity) (local.get $max_length))
        (then (local.set $capacity (local.get $max_length))))
    (if (i64.gt_u
            (i64.add (i64.add (local.get $top) (local.get $capacity)) (i64.const 1))
            (local.get $end))
        (then (return (i64.const 0))))
    (local.set $from (call $address (local.get $base) (i64.load offset=16 (local.get $address))))
    (local.set $to (call $address (local.get $base) (local.get $top)))
    (i64.store (local.get $to)
        (i64.or
            (i64.load32_u (local.get $from))
            (i64.shl (i64.add (local.get $capacity) (i64.const 1)) (i64.const 32))))
    (memory.copy
        (i32.add (local.get $to) (i32.const 8))
        (i32.add (local.get $from) (i32.const 8))
        (i32.shl (i32.wrap_i64 (local.get $length)) (i32.const 3)))
    (memory.fill
        (i32.add
            (local.get $to)
            (i32.shl (i32.wrap_i64 (i64.add (local.get $length) (i64.const 1))) (i32.const 3)))
        (i32.const 0)
        (i32.shl (i32.wrap_i64 (i64.sub (local.get $capacity) (local.get $length))) (i32.const 3)))
    (i64.store offset=16 (local.get $address) (local.get $top))
    (i64.add (local.get $capacity) (i64.const 1)))
