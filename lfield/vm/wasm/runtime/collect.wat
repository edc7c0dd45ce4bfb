;; The collector: Cheney's algorithm; same bytes as lfield/vm/memory/collector.py. The spare words of growable
;; arrays are dropped.
;;
;; $tables  address of the records of the program (runtime_tables.py); record 0 of kind 0 is the block's header
;; $from    address of the old space, of $used words; headers of live objects there are overwritten
;; $to      address of the new space, of $capacity words, with the header of the block already in it
;; $header_words  number of words of that header
;; Returns the first unused word of the new space.

(func $collect (export "collect")
    (param $tables i32) (param $from i32) (param $used i64) (param $to i32) (param $capacity i64)
    (param $header_words i32)
    (result i32)
    (local $top i32) (local $scan i32) (local $record i32) (local $size i32)
    (local $remaining i32) (local $list i32) (local $offset i32) (local $slot i32)
    (local $limit i64) (local $words i64) (local $index i64) (local $old i32) (local $header i64)
    (local $bytes i32) (local $address i32) (local $header_low i32)
    (local.set $limit
        (i64.add (i64.extend_i32_u (local.get $to)) (i64.shl (local.get $capacity) (i64.const 3))))
    (local.set $scan (local.get $to))
    (local.set $size (i32.shl (local.get $header_words) (i32.const 3)))
    (local.set $top (i32.add (local.get $to) (local.get $size)))
    (local.set $record (i32.add (local.get $tables) (i32.load (local.get $tables))))
    (loop $objects
        ;; The references of one object: all words after the header, or those at the listed offsets.
        (local.set $offset (i32.const 0))
        (local.set $list (i32.const 0))
        (local.set $remaining (i32.load offset=4 (local.get $record)))
        (if (i32.lt_s (local.get $remaining) (i32.const 0))
            (then
                (local.set $remaining
                    (i32.sub (i32.shr_u (local.get $size) (i32.const 3)) (i32.const 1))))
            (else
                (local.set $list
                    (i32.add (local.get $tables) (i32.load offset=8 (local.get $record))))))
        (block $scanned
            (loop $references
                (br_if $scanned (i32.eqz (local.get $remaining)))
                (local.set $remaining (i32.sub (local.get $remaining) (i32.const 1)))
                (if (local.get $list)
                    (then
                        (local.set $offset (i32.load (local.get $list)))
                        (local.set $list (i32.add (local.get $list) (i32.const 8))))
                    (else
                        (local.set $offset (i32.add (local.get $offset) (i32.const 8)))))
                (if (i32.ge_u (local.get $offset) (local.get $size)) (then unreachable))
                (local.set $slot (i32.add (local.get $scan) (local.get $offset)))
                (br_if $references (i64.eqz (local.tee $index (i64.load (local.get $slot)))))
                (if (i64.ge_u (local.get $index) (local.get $used)) (then unreachable))
                (local.set $old
                    (i32.add (local.get $from) (i32.shl (i32.wrap_i64 (local.get $index)) (i32.const 3))))
                (local.set $header (i64.load (local.get $old)))
                (if (i64.lt_s (local.get $header) (i64.const 0))
                    (then
                        ;; The object has moved: its header is the negated new index.
                        (i64.store (local.get $slot) (i64.sub (i64.const 0) (local.get $header)))
                        (if (i32.eq (i32.and (local.get $header_low) (i32.const 255)) (i32.const 8))
                            (then
                                (local.set $words
                                    (i64.sub
                                        (i64.load32_u offset=4
                                            (call $address (local.get $to)
                                                (i64.sub (i64.const 0) (local.get $header))))
                                        (i64.const 1)))
                                (if (i64.gt_s (i64.load offset=8 (local.get $scan)) (local.get $words))
                                    (then
                                        (i64.store offset=8 (local.get $scan) (local.get $words))))))
                        (br $references)))
                (if (i32.eq (i32.and (local.get $header_low) (i32.const 255)) (i32.const 8))
                    (then
                        (local.set $words
                            (i64.add (i64.load offset=8 (local.get $scan)) (i64.const 1)))
                        (local.set $header
                            (i64.or
                                (i64.and (local.get $header) (i64.const 0xFFFFFFFF))
                                (i64.shl (local.get $words) (i64.const 32))))
                        (i64.store (local.get $old) (local.get $header))))
                (local.set $words (i64.shr_u (local.get $header) (i64.const 32)))
                (local.set $bytes (i32.shl (i32.wrap_i64 (local.get $words)) (i32.const 3)))
                (if (i32.or
                        (i64.gt_u (i64.add (local.get $index) (local.get $words)) (local.get $used))
                        (i64.gt_u
                            (i64.add
                                (i64.extend_i32_u (local.get $top))
                                (i64.extend_i32_u (local.get $bytes)))
                            (local.get $limit)))
                    (then unreachable))
                (local.set $index
                    (i64.extend_i32_u
                        (i32.shr_u (i32.sub (local.get $top) (local.get $to)) (i32.const 3))))
                (i64.store (local.get $slot) (local.get $index))
                (if (i32.gt_u (local.get $bytes) (i32.const 256))
                    (then
                        (memory.copy (local.get $top) (local.get $old) (local.get $bytes)))
                    (else
                        (i64.store (local.get $top) (local.get $header))
                        (local.set $address (i32.const 8))
                        (block $copied
                            (loop $words
                                (br_if $copied (i32.ge_u (local.get $address) (local.get $bytes)))
                                (i64.store
                                    (i32.add (local.get $top) (local.get $address))
                                    (i64.load (i32.add (local.get $old) (local.get $address))))
                                (local.set $address (i32.add (local.get $address) (i32.const 8)))
                                (br $words)))))
                (local.set $top (i32.add (local.get $top) (local.get $bytes)))
                (i64.store (local.get $old) (i64.sub (i64.const 0) (local.get $index)))
                (br $references)))
        ;; The next object of the new space, which is its own work list.
        (local.set $scan (i32.add (local.get $scan) (local.get $size)))
        (if (i32.lt_u (local.get $scan) (local.get $top))
            (then
                (local.set $header (i64.load (local.get $scan)))
                (local.set $size
                    (i32.shl (i32.wrap_i64 (i64.shr_u (local.get $header) (i64.const 32))) (i32.const 3)))
                ;; Objects of one kind often follow one another.
                (if (i32.ne (i32.wrap_i64 (local.get $header)) (local.get $header_low))
                    (then
                        (local.set $header_low (i32.wrap_i64 (local.get $header)))
                        (local.set $record (call $record (local.get $tables) (local.get $header_low)))))
                (br $objects))))
    (i32.shr_u (i32.sub (local.get $top) (local.get $to)) (i32.const 3)))
