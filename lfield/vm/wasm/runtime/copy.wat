;; Deep copy; same order and bytes as lfield/vm/memory/copier.py.
;;
;; $tables   address of the records of the program; their first word is the offset (in bytes) of the reference
;;           that is not copied, 0 for none
;; $source   address of the source block, of $used words; during the copy the header of a found object is the
;;           negated index of its copy
;; $target   address of the target block, maybe the same; $top and $end in words
;; $roots    address of $count references; they are replaced by those of the copies
;; $scratch  address of 16 bytes for every word of the source and every root: from below the list of found
;;           objects (index, header), from above ($last) the stack of references that are not yet followed
;; Returns the new top, or, when the space is too small, the negated number of words needed, without changes.

(func $deep_copy (export "deep_copy")
    (param $tables i32) (param $source i32) (param $used i64)
    (param $target i32) (param $top i64) (param $end i64)
    (param $roots i32) (param $count i32) (param $scratch i32) (param $last i32)
    (result i64)
    (local $words i64)
    (local.set $words
        (call $closure (local.get $tables) (local.get $source) (local.get $used) (local.get $top)
            (local.get $roots) (local.get $count) (local.get $scratch) (local.get $last)))
    (if (i64.gt_s (i64.add (local.get $top) (local.get $words)) (local.get $end))
        (then
            (call $restore (local.get $source) (local.get $scratch))
            (return (i64.sub (i64.const 0) (local.get $words)))))
    (call $write (local.get $tables) (local.get $source) (local.get $target) (local.get $top)
        (local.get $scratch))
    (call $translate (local.get $source) (local.get $roots) (local.get $count))
    (call $restore (local.get $source) (local.get $scratch))
    (i64.add (local.get $top) (local.get $words)))

;; Finds everything reachable, last reference first; returns its size in words. The list ends with the index 0.
(func $closure
    (param $tables i32) (param $source i32) (param $used i64) (param $top i64)
    (param $roots i32) (param $count i32) (param $found i32) (param $last i32)
    (result i64)
    (local $stack i32) (local $words i64) (local $index i64) (local $address i32) (local $header i64) (local $size i64)
    (local $record i32) (local $uncopied i32) (local $remaining i32) (local $list i32) (local $offset i32)
    ;; The stack grows downwards from $last. The roots are pushed from the first to the last.
    (local.set $stack (local.get $last))
    (block $pushed
        (loop $push
            (br_if $pushed (i32.eqz (local.get $count)))
            (local.set $stack (i32.sub (local.get $stack) (i32.const 8)))
            (i64.store (local.get $stack) (i64.load (local.get $roots)))
            (local.set $roots (i32.add (local.get $roots) (i32.const 8)))
            (local.set $count (i32.sub (local.get $count) (i32.const 1)))
            (br $push)))
    (block $done
        (loop $pop
            (br_if $done (i32.eq (local.get $stack) (local.get $last)))
            (local.set $index (i64.load (local.get $stack)))
            (local.set $stack (i32.add (local.get $stack) (i32.const 8)))
            (br_if $pop (i64.eqz (local.get $index)))
            (if (i64.ge_u (local.get $index) (local.get $used)) (then unreachable))
            (local.set $address
                (i32.add (local.get $source) (i32.shl (i32.wrap_i64 (local.get $index)) (i32.const 3))))
            (local.set $header (i64.load (local.get $address)))
            ;; The object was found before.
            (br_if $pop (i64.lt_s (local.get $header) (i64.const 0)))
            (i64.store (local.get $found) (local.get $index))
            (i64.store offset=8 (local.get $found) (local.get $header))
            (local.set $found (i32.add (local.get $found) (i32.const 16)))
            (i64.store (local.get $address)
                (i64.sub (i64.const 0) (i64.add (local.get $top) (local.get $words))))
            (local.set $size (i64.shr_u (local.get $header) (i64.const 32)))
            (if (i64.gt_u (i64.add (local.get $index) (local.get $size)) (local.get $used))
                (then unreachable))
            (local.set $words (i64.add (local.get $words) (local.get $size)))
            (local.set $record (call $record (local.get $tables) (i32.wrap_i64 (local.get $header))))
            (local.set $uncopied (i32.load (local.get $record)))
            (local.set $offset (i32.const 0))
            (local.set $list (i32.const 0))
            (local.set $remaining (i32.load offset=4 (local.get $record)))
            (if (i32.lt_s (local.get $remaining) (i32.const 0))
                (then
                    (local.set $remaining (i32.sub (i32.wrap_i64 (local.get $size)) (i32.const 1))))
                (else
                    (local.set $list
                        (i32.add (local.get $tables) (i32.load offset=8 (local.get $record))))))
            (loop $references
                (br_if $pop (i32.eqz (local.get $remaining)))
                (local.set $remaining (i32.sub (local.get $remaining) (i32.const 1)))
                (if (local.get $list)
                    (then
                        (local.set $offset (i32.load (local.get $list)))
                        (local.set $list (i32.add (local.get $list) (i32.const 8)))
                        (if (i64.ge_u
                                (i64.extend_i32_u (local.get $offset))
                                (i64.shl (local.get $size) (i64.const 3)))
                            (then unreachable))
                        (br_if $references (i32.eq (local.get $offset) (local.get $uncopied))))
                    (else
                        (local.set $offset (i32.add (local.get $offset) (i32.const 8)))))
                (local.set $index (i64.load (i32.add (local.get $address) (local.get $offset))))
                (br_if $references (i64.eqz (local.get $index)))
                (local.set $stack (i32.sub (local.get $stack) (i32.const 8)))
                (if (i32.lt_u (local.get $stack) (i32.add (local.get $found) (i32.const 16)))
                    (then unreachable))
                (i64.store (local.get $stack) (local.get $index))
                (br $references))))
    (i64.store (local.get $found) (i64.const 0))
    (local.get $words))

;; Writes the copies in sequence, with translated references.
(func $write
    (param $tables i32) (param $source i32) (param $target i32) (param $top i64) (param $found i32)
    (local $destination i32) (local $index i64) (local $address i32) (local $header i64) (local $bytes i32)
    (local $record i32) (local $remaining i32) (local $uncopied i32) (local $list i32) (local $slot i32)
    (local.set $destination
        (i32.add (local.get $target) (i32.shl (i32.wrap_i64 (local.get $top)) (i32.const 3))))
    (block $done
        (loop $objects
            (br_if $done (i64.eqz (local.tee $index (i64.load (local.get $found)))))
            (local.set $address
                (i32.add (local.get $source) (i32.shl (i32.wrap_i64 (local.get $index)) (i32.const 3))))
            (local.set $header (i64.load offset=8 (local.get $found)))
            (local.set $bytes
                (i32.shl (i32.wrap_i64 (i64.shr_u (local.get $header) (i64.const 32))) (i32.const 3)))
            (call $move (local.get $destination) (local.get $address) (local.get $bytes))
            (i64.store (local.get $destination) (local.get $header))
            (local.set $record (call $record (local.get $tables) (i32.wrap_i64 (local.get $header))))
            (local.set $remaining (i32.load offset=4 (local.get $record)))
            (if (i32.lt_s (local.get $remaining) (i32.const 0))
                (then
                    (call $translate (local.get $source)
                        (i32.add (local.get $destination) (i32.const 8))
                        (i32.sub (i32.shr_u (local.get $bytes) (i32.const 3)) (i32.const 1))))
                (else
                    (local.set $uncopied (i32.load (local.get $record)))
                    (if (local.get $uncopied)
                        (then
                            (i64.store
                                (i32.add (local.get $destination) (local.get $uncopied)) (i64.const 0))))
                    (local.set $list
                        (i32.add (local.get $tables) (i32.load offset=8 (local.get $record))))
                    (block $translated
                        (loop $references
                            (br_if $translated (i32.eqz (local.get $remaining)))
                            (call $translate (local.get $source)
                                (i32.add (local.get $destination) (i32.load (local.get $list)))
                                (i32.const 1))
                            (local.set $list (i32.add (local.get $list) (i32.const 8)))
                            (local.set $remaining (i32.sub (local.get $remaining) (i32.const 1)))
                            (br $references)))))
            (local.set $destination (i32.add (local.get $destination) (local.get $bytes)))
            (local.set $found (i32.add (local.get $found) (i32.const 16)))
            (br $objects))))

;; Translates $count consecutive references to the copies.
(func $translate (param $source i32) (param $slot i32) (param $count i32)
    (local $index i64)
    (block $done
        (loop $next
            (br_if $done (i32.eqz (local.get $count)))
            (if (i64.ne (local.tee $index (i64.load (local.get $slot))) (i64.const 0))
                (then
                    (i64.store (local.get $slot)
                        (i64.sub
                            (i64.const 0)
                            (i64.load
                                (i32.add (local.get $source)
                                    (i32.shl (i32.wrap_i64 (local.get $index)) (i32.const 3))))))))
            (local.set $slot (i32.add (local.get $slot) (i32.const 8)))
            (local.set $count (i32.sub (local.get $count) (i32.const 1)))
            (br $next))))

;; Restores the headers of the source.
(func $restore (param $source i32) (param $found i32)
    (local $index i64)
    (block $done
        (loop $next
            (br_if $done (i64.eqz (local.tee $index (i64.load (local.get $found)))))
            (i64.store
                (i32.add (local.get $source) (i32.shl (i32.wrap_i64 (local.get $index)) (i32.const 3)))
                (i64.load offset=8 (local.get $found)))
            (local.set $found (i32.add (local.get $found) (i32.const 16)))
            (br $next))))
